/** How much of a long list is made: some more in each frame, so that the page is drawn meanwhile. */
export class Gradual {
  made = $state(0);

  /** To be called in a component; `step` is what can be made in a frame, `total` how long the list is. */
  constructor(step: number, total: () => number) {
    this.made = step;
    $effect(() => {
      const wanted = total();
      if (this.made > wanted + step) this.made = wanted + step; // what comes again is made bit by bit again
      if (this.made >= wanted) return;
      const next = requestAnimationFrame(() => (this.made += step));
      return () => cancelAnimationFrame(next);
    });
  }
}

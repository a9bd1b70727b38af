const REST = 500; // ms: longer than it takes to press what one has seen

/** Which parts of a list have stood where they are for a while: what has only just slid under the pointer is not pressed. */
export class Steady {
  still = $state.raw<ReadonlySet<string>>(new Set());
  #places = new Map<string, { place: number; since: number }>();
  #list: HTMLElement | undefined;

  /** Follow the parts of a list that have `data-steady`, until the returned function is called. */
  follow(list: HTMLElement): () => void {
    this.#list = list;
    let frame = 0;
    const next = (): void => {
      frame = requestAnimationFrame(next);
      this.#look();
    };
    next();
    return () => cancelAnimationFrame(frame);
  }

  /** Whether a press is meant for this part, as it stands at this moment. By the keyboard it always is. */
  meant(name: string, event: MouseEvent): boolean {
    this.#look();
    return event.detail === 0 || this.still.has(name);
  }

  #look(): void {
    const list = this.#list;
    if (!list) return;
    const [now, scrolled] = [performance.now(), list.closest("main")?.scrollTop ?? 0];
    const before = this.#places;
    this.#places = new Map();
    for (const part of list.querySelectorAll<HTMLElement>("[data-steady]")) {
      const name = part.dataset["steady"]!;
      const place = part.getBoundingClientRect().top + scrolled; // whoever scrolls knows that it moves
      const known = before.get(name);
      this.#places.set(name, known && Math.abs(known.place - place) < 1 ? known : { place, since: now });
    }
    const still = [...this.#places].filter(([, one]) => now - one.since >= REST).map(([name]) => name);
    if (still.length !== this.still.size || still.some((name) => !this.still.has(name))) this.still = new Set(still);
  }
}

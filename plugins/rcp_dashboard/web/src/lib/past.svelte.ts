import { app } from "./app.svelte.ts";

const EDGE = 2000; // ms: what is newer may not be on the disk yet
const TICK = 100; // ms
const LONGEST = 1000; // ms that one tick moves at most: a tab that nobody sees has slow timers

/** The moment that pages show in place of the present, and how it moves on. */
class Past {
  /** In ms since the epoch, by the gateway's clock; undefined: the present. */
  at = $state<number>();
  playing = $state(false);
  speed = $state(1);
  /** Whether the page that is shown looks at this moment: others go on showing the present. */
  follows = $state(false);
  /** Rises with each leap: what was shown before does not lead up to what is shown now. */
  leaps = $state(0);
  /** Rises where a page has to begin anew, as something that it shows had no value yet. */
  voids = $state(0);
  /** Whether what was recorded at this moment is still on its way: then it does not move on. */
  waiting = $state(false);
  /** Whether all that was there when it was last asked for has been played. */
  caughtUp = false;
  /** Why nothing comes. */
  problem = $state("");
  readonly active = $derived(this.at !== undefined);
  readonly shown = $derived(this.active && this.follows);
  #timer: ReturnType<typeof setInterval> | undefined;

  /** The newest moment that can be looked at. */
  get newest(): number {
    return app.client.clock.now() - EDGE;
  }

  /** Look at a moment. */
  go(at: number): void {
    this.at = Math.max(0, Math.min(at, this.newest));
    this.leaps += 1;
  }

  play(): void {
    if (!this.active || this.playing) return;
    this.playing = true;
    this.caughtUp = false;
    let looked = performance.now();
    this.#timer = setInterval(() => {
      const now = performance.now();
      const passed = Math.min(LONGEST, now - looked);
      looked = now;
      if (this.at === undefined) return;
      if (!this.waiting) this.at = Math.min(this.at + passed * this.speed, this.newest);
      if (this.at >= this.newest || (this.caughtUp && this.speed > 1)) this.pause();
    }, TICK);
  }

  pause(): void {
    this.playing = false;
    clearInterval(this.#timer);
  }

  /** Show the present again. */
  leave(): void {
    this.pause();
    this.at = undefined;
    this.problem = "";
    this.waiting = false;
  }
}

export const past = new Past();

/** The end of what is shown over time, in s since the epoch: now, or the moment in the past. */
export function momentShown(): number {
  return (past.shown && past.at !== undefined ? past.at : app.client.clock.now()) / 1000;
}

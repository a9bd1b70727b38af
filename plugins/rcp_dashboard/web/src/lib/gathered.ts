const EVERY = 250; // ms: a page is not drawn anew for each of thousands

/** What comes, handed over a few times a second: of each key the newest, and of many keys the newest `most`. */
export class Gathered<T> {
  readonly #most: number;
  readonly #take: (all: Map<string, T>) => void;
  #held = new Map<string, T>();
  #timer: ReturnType<typeof setTimeout> | undefined;

  constructor(most: number, take: (all: Map<string, T>) => void) {
    this.#most = most;
    this.#take = take;
  }

  add(key: string, one: T): void {
    this.#held.delete(key);
    this.#held.set(key, one);
    if (this.#held.size > this.#most) this.#held.delete(this.#held.keys().next().value as string); // the timers of a hidden tab are slow
    this.#timer ??= setTimeout(() => {
      const all = this.#held;
      this.#held = new Map();
      this.#timer = undefined;
      this.#take(all);
    }, EVERY);
  }

  /** Forget what has not been handed over. */
  stop(): void {
    clearTimeout(this.#timer);
    this.#timer = undefined;
    this.#held = new Map();
  }
}

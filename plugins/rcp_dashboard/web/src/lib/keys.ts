import { type Speeds, STILL } from "./twist.ts";

const DRIVES: Record<string, Partial<Speeds>> = {
  ArrowUp: { forward: 1 },
  w: { forward: 1 },
  ArrowDown: { forward: -1 },
  s: { forward: -1 },
  ArrowLeft: { turn: 1 },
  a: { turn: 1 },
  ArrowRight: { turn: -1 },
  d: { turn: -1 },
  q: { side: 1 },
  e: { side: -1 },
  r: { up: 1 },
  f: { up: -1 },
};
const AXES = ["forward", "side", "up", "turn"] as const;
const SLIDES = /^(Arrow|Page|Home$|End$)/;
const TYPED = "input:not([type=range]), select, textarea";

/** Keys that are held: Shift is the dead-man, arrows and letters say where to. */
export class Keys {
  readonly #told: (wish: Speeds | undefined) => void;
  readonly #held = new Set<string>();
  /** Keys that were down together with Shift: they go on repeating when it is let go of first. */
  readonly #drove = new Set<string>();

  /** Tell of each change what is wanted, `undefined` while Shift is not held. */
  constructor(told: (wish: Speeds | undefined) => void) {
    this.#told = told;
  }

  down(event: KeyboardEvent): void {
    const target = event.target as Element;
    const key = name(event);
    // What is let go beside these is not always told, and a dialog covers what is driven.
    if (event.ctrlKey || event.altKey || event.metaKey || target.closest("dialog")) return this.#letGo();
    if (target.matches(TYPED)) return;
    if (event.shiftKey) this.#drove.add(key);
    // Keys that drive scroll nothing, and never move a slider: the limits of speed are some.
    if (target.matches("input") ? this.#drove.has(key) && SLIDES.test(key) : key.startsWith("Arrow")) event.preventDefault();
    this.seen(event);
    if (event.repeat) return; // what is held since before the page was looked at has to be pressed anew
    this.#held.add(key);
    this.#tell();
  }

  up(event: KeyboardEvent): void {
    const key = name(event);
    this.#drove.delete(key);
    if (this.#held.delete(key)) this.#tell();
  }

  /** Any event tells whether Shift is still held: that it was let go may have been told to somebody else. */
  seen(event: KeyboardEvent | PointerEvent): void {
    if (this.#held.has("Shift") && !event.shiftKey) this.#letGo();
  }

  /** What is typed into has the keys from now on, and a list that it opens does not tell what is let go. */
  focused(event: FocusEvent): void {
    if ((event.target as Element).matches?.(TYPED)) this.#letGo();
  }

  /** Forget what is held, as the page does not see it any more. */
  clear(): void {
    this.#held.clear();
    this.#drove.clear();
  }

  #letGo(): void {
    this.#held.clear();
    this.#told(undefined);
  }

  #tell(): void {
    if (!this.#held.has("Shift")) return this.#told(undefined);
    const wish = { ...STILL };
    for (const key of this.#held) for (const axis of AXES) wish[axis] += DRIVES[key]?.[axis] ?? 0;
    for (const axis of AXES) wish[axis] = Math.max(-1, Math.min(1, wish[axis]));
    this.#told(wish);
  }
}

const name = ({ key }: KeyboardEvent): string => (key.length === 1 ? key.toLowerCase() : key);

import { away } from "./away.ts";
import { type Speeds, STILL } from "./twist.ts";

const PERIOD = 50; // ms between looks: gamepads tell nothing by events
const DEAD = 0.12; // of a stick's way, around its middle
const SHOULDERS = [4, 5, 6, 7]; // of the standard mapping

/** The gamepads that are there, in the standard mapping: left stick drives, right stick moves sideways and up. */
export class Pads {
  /** Of the one whose shoulder button is held, else of the first. */
  name = $state("");
  /** Of one that is there and has another mapping: nobody knows what its axes and buttons are. */
  strange = $state("");

  /**
   * Look at them until the returned function is called.
   *
   * Each is told by itself, with `undefined` where no shoulder button is held or it is gone. Of those that are held while
   * nobody is at the page, or were held before, `left` is told instead: at once, so that a look that comes late takes no
   * old press for a new one.
   */
  watch(told: (source: string, wish: Speeds | undefined) => void, left: (source: string) => void): () => void {
    const seen = new Set<string>();
    const look = (begins: boolean): void => {
      const there = [...(navigator.getGamepads?.() ?? [])].filter((one) => one?.connected) as Gamepad[];
      const pads = there.filter((one) => one.mapping === "standard");
      const held = pads.filter((one) => SHOULDERS.some((at) => one.buttons[at]?.pressed));
      this.name = (held[0] ?? pads[0])?.id ?? "";
      this.strange = there.find((one) => one.mapping !== "standard")?.id ?? "";
      for (const pad of pads) seen.add(source(pad));
      const nobody = away();
      for (const one of seen) {
        const pad = held.find((other) => source(other) === one);
        if (pad && (nobody || begins)) left(one);
        else told(one, pad && this.#wish(pad));
      }
    };
    look(true);
    const timer = setInterval(() => look(false), PERIOD);
    return () => clearInterval(timer);
  }

  #wish(pad: Gamepad): Speeds {
    const at = (axis: number): number => {
      const value = pad.axes[axis] ?? 0;
      return Math.abs(value) < DEAD ? 0 : -value;
    };
    return { ...STILL, turn: at(0), forward: at(1), side: at(2), up: at(3) };
  }
}

const source = (pad: Gamepad): string => (pad.index === 0 ? "gamepad" : `gamepad ${pad.index + 1}`);

import { type Speeds, STILL } from "./twist.ts";

const PERIOD = 50; // ms between looks: gamepads tell nothing by events
const DEAD = 0.12; // of a stick's way, around its middle
const SHOULDERS = [4, 5, 6, 7]; // of the standard mapping

/** The first gamepad that is there, in the standard mapping: left stick drives, right stick moves sideways and up. */
export class Pad {
  name = $state("");

  /** Look at it until the returned function is called; `undefined` where no shoulder button is held, or it is gone. */
  watch(told: (wish: Speeds | undefined) => void): () => void {
    const timer = setInterval(() => {
      const all = [...(navigator.getGamepads?.() ?? [])].filter((one) => one?.connected) as Gamepad[];
      const held = all.find((one) => SHOULDERS.some((at) => one.buttons[at]?.pressed));
      this.name = (held ?? all[0])?.id ?? "";
      told(held && this.#wish(held));
    }, PERIOD);
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

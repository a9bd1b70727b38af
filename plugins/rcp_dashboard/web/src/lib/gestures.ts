import type uPlot from "uplot";

export interface Range {
  from: number;
  to: number;
}

const STEP = 1.2; // of zoom, of one notch of the wheel
const LEAST = 0.05; // s
const NEAR = 8; // pixels between two fingers that are too near to zoom

/** A finger on a plot, with the time that it lies on. */
interface Finger {
  x: number;
  time: number;
}

/** Zoom by the wheel about the cursor, move by Shift and the wheel; with fingers move by one, zoom by two. */
export function gestures(told: (range: Range) => void): uPlot.Plugin {
  /** What was told and is not drawn yet: the next event goes on from that. */
  let next: Range | undefined;
  const fingers = new Map<number, Finger>();

  function follow(u: uPlot): void {
    const over = u.over;
    const range = (): Range => next ?? { from: u.scales["x"]?.min ?? 0, to: u.scales["x"]?.max ?? 1 };
    const tell = (wanted: Range): void => told((next = wanted));
    const place = (event: MouseEvent): number => (event.clientX - over.getBoundingClientRect().left) / over.clientWidth;
    const zoom = (at: number, by: number): void => {
      const { from, to } = range();
      const length = Math.max(LEAST, (to - from) * by);
      const middle = from + at * (to - from);
      tell({ from: middle - at * length, to: middle + (1 - at) * length });
    };
    /** Fingers keep to the times that they lie on now. */
    const grasp = (): void => {
      const { from, to } = range();
      for (const finger of fingers.values()) finger.time = from + finger.x * (to - from);
    };
    const drag = (): void => {
      const { from, to } = range();
      const [a, b] = [...fingers.values()] as [Finger, Finger?];
      if (!b) return tell({ from: a.time - a.x * (to - from), to: a.time + (1 - a.x) * (to - from) });
      const length = (b.time - a.time) / (b.x - a.x);
      if (Math.abs(b.x - a.x) * over.clientWidth < NEAR || length < LEAST) return;
      tell({ from: a.time - a.x * length, to: a.time + (1 - a.x) * length });
    };
    over.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const { from, to } = range();
        const by = event.shiftKey ? (event.deltaY || event.deltaX) * 0.001 * (to - from) : 0;
        if (by) tell({ from: from + by, to: to + by });
        else zoom(place(event), event.deltaY > 0 ? STEP : 1 / STEP);
      },
      { passive: false },
    );
    over.style.touchAction = "pan-y";
    over.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "touch" || fingers.size === 2) return;
      fingers.set(event.pointerId, { x: place(event), time: 0 });
      grasp();
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"] as const)
      over.addEventListener(name, (event) => {
        if (fingers.delete(event.pointerId)) grasp();
      });
    over.addEventListener("pointermove", (event) => {
      const finger = fingers.get(event.pointerId);
      if (!finger) return;
      finger.x = place(event);
      drag();
    });
  }

  return { hooks: { ready: follow, setScale: (_: uPlot, key: string) => void (key === "x" && (next = undefined)) } };
}

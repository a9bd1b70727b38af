import type uPlot from "uplot";

export interface Range {
  from: number;
  to: number;
}

const STEP = 1.2; // of zoom, of one notch of the wheel
const LEAST = 0.05; // s

/** Zoom by the wheel about the cursor, move by Shift and the wheel; with fingers move by one, zoom by two. */
export function gestures(told: (range: Range) => void): uPlot.Plugin {
  return {
    hooks: {
      ready: (u: uPlot) => {
        const over = u.over;
        const range = (): Range => ({ from: u.scales["x"]?.min ?? 0, to: u.scales["x"]?.max ?? 1 });
        const zoom = (at: number, by: number): void => {
          const { from, to } = range();
          const length = Math.max(LEAST, (to - from) * by);
          const middle = from + at * (to - from);
          told({ from: middle - at * length, to: middle + (1 - at) * length });
        };
        over.addEventListener(
          "wheel",
          (event) => {
            event.preventDefault();
            const { from, to } = range();
            const by = event.shiftKey ? (event.deltaY || event.deltaX) * 0.001 * (to - from) : 0;
            if (by) told({ from: from + by, to: to + by });
            else zoom(event.offsetX / over.clientWidth, event.deltaY > 0 ? STEP : 1 / STEP);
          },
          { passive: false },
        );
        const fingers = new Map<number, number>();
        over.style.touchAction = "pan-y";
        over.addEventListener("pointerdown", (event) => event.pointerType === "touch" && fingers.set(event.pointerId, event.offsetX));
        const lift = (event: PointerEvent): unknown => fingers.delete(event.pointerId);
        for (const name of ["pointerup", "pointercancel", "pointerleave"] as const) over.addEventListener(name, lift);
        over.addEventListener("pointermove", (event) => {
          const before = fingers.get(event.pointerId);
          if (before === undefined) return;
          const others = [...fingers].filter(([id]) => id !== event.pointerId).map(([, x]) => x);
          fingers.set(event.pointerId, event.offsetX);
          const { from, to } = range();
          if (others.length === 0) {
            const by = ((before - event.offsetX) / over.clientWidth) * (to - from);
            if (by) told({ from: from + by, to: to + by });
          } else {
            const other = others[0] as number;
            const [was, is] = [Math.abs(before - other), Math.abs(event.offsetX - other)];
            if (was > 8 && is > 8) zoom((event.offsetX + other) / 2 / over.clientWidth, was / is);
          }
        });
      },
    },
  };
}

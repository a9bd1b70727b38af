interface Spot {
  x: number;
  y: number;
}

/** Two fingers that move: how much farther apart they are now, and where their middle was and is. */
export type Pinched = (by: number, from: Spot, to: Spot) => void;

const NEAR = 24; // pixels between two fingers that are too near to zoom

/** Tell of two fingers that move on an element, while that is `wanted`; returns what ends it. */
export function pinches(on: HTMLElement, wanted: () => boolean, told: Pinched): () => void {
  const over = new AbortController();
  const fingers = new Map<number, Spot>();
  const spread = (): { far: number; middle: Spot } => {
    const [a, b] = [...fingers.values()] as [Spot, Spot];
    return { far: Math.max(NEAR, Math.hypot(a.x - b.x, a.y - b.y)), middle: { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 } };
  };
  const listen = (name: "pointerdown" | "pointermove" | "pointerup" | "pointercancel" | "lostpointercapture", take: (event: PointerEvent) => void): void =>
    on.addEventListener(name, (event) => event.pointerType === "touch" && take(event), { signal: over.signal });
  const leave = (event: PointerEvent): void => void fingers.delete(event.pointerId);
  listen("pointerdown", (event) => {
    if (fingers.size === 2) return;
    fingers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    on.setPointerCapture(event.pointerId);
  });
  listen("pointermove", (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) return;
    const before = fingers.size === 2 && wanted() ? spread() : undefined;
    [finger.x, finger.y] = [event.offsetX, event.offsetY];
    if (!before) return;
    const after = spread();
    told(after.far / before.far, before.middle, after.middle);
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"] as const) listen(name, leave);
  return () => over.abort();
}

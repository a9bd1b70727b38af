export interface Press {
  /** It begins; false where it means nothing. */
  down: (event: PointerEvent) => boolean;
  move: (event: PointerEvent) => void;
  up: (event: PointerEvent) => void;
  /** Something else came between: another finger or button, Escape, a menu, another window; or it ended elsewhere. */
  cancel: () => void;
}

/**
 * Tell of presses of the main button, or of one finger, that begin on an element and on nothing that lies over it.
 *
 * Each `down` is followed by one `up` or one `cancel`, wherever the pointer went. Returns what ends it.
 */
export function presses(on: HTMLElement, told: Press): () => void {
  const over = new AbortController();
  const { signal } = over;
  let id: number | undefined;
  const cancel = (): void => {
    if (id === undefined) return;
    id = undefined;
    told.cancel();
  };
  const mine = (name: "pointermove" | "pointerup" | "pointercancel" | "lostpointercapture", take: (event: PointerEvent) => void): void =>
    on.addEventListener(name, (event) => event.pointerId === id && take(event), { signal });
  addEventListener("pointerdown", (event) => event.pointerId !== id && cancel(), { signal, capture: true });
  on.addEventListener(
    "pointerdown",
    (event) => {
      const plain = event.target === on && event.button === 0 && event.buttons === 1 && event.isPrimary && !event.ctrlKey; // with Control it asks for a menu
      if (id !== undefined || !plain || !told.down(event)) return;
      id = event.pointerId;
      on.setPointerCapture(id);
    },
    { signal },
  );
  mine("pointermove", (event) => (event.buttons === 1 ? told.move(event) : cancel()));
  mine("pointerup", (event) => {
    if (event.button !== 0 || document.elementFromPoint(event.clientX, event.clientY) !== on) return cancel();
    id = undefined;
    told.up(event);
  });
  mine("pointercancel", cancel);
  mine("lostpointercapture", cancel);
  on.addEventListener("contextmenu", cancel, { signal });
  addEventListener("blur", cancel, { signal });
  addEventListener("keydown", (event) => event.key === "Escape" && cancel(), { signal });
  return () => {
    over.abort();
    cancel();
  };
}

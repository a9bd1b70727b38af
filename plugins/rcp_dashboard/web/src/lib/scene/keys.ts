import type { View } from "./view.ts";

const STEP = 0.1; // of the height of the view
const ZOOM = 1.25;
const MOVES: Record<string, [right: number, up: number]> = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };

interface Told {
  /** What is in the middle has changed. */
  moved: () => void;
  /** Enter was pressed. */
  entered: () => void;
}

/** Let the keyboard move a view and choose its middle; returns what ends it. */
export function steered(view: View, label: string, told: Told): () => void {
  const { canvas } = view;
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application");
  canvas.setAttribute("aria-label", label);
  const onkeydown = (event: KeyboardEvent): void => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const move = MOVES[event.key];
    if (move) view.pan(...move);
    else if (event.key === "+" || event.key === "-") view.zoom(event.key === "+" ? ZOOM : 1 / ZOOM);
    else if (event.key !== "Enter") return;
    event.preventDefault();
    if (event.key !== "Enter") told.moved();
    else if (!event.repeat) told.entered();
  };
  canvas.addEventListener("keydown", onkeydown);
  return () => canvas.removeEventListener("keydown", onkeydown);
}

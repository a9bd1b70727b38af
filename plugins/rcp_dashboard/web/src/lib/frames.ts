/** What is drawn anew all the time takes turns: together it would not fit into one frame. */
const drawn: (() => void)[] = [];
let frame = 0;
let turn = 0;

function next(): void {
  frame = requestAnimationFrame(next);
  for (let left = Math.ceil(drawn.length / 3); left > 0; left--) drawn[turn++ % drawn.length]?.();
}

/** Call again and again, at least 20 times a second; returns what ends that. */
export function animated(draw: () => void): () => void {
  drawn.push(draw);
  if (drawn.length === 1) frame = requestAnimationFrame(next);
  return () => {
    drawn.splice(drawn.indexOf(draw), 1);
    if (drawn.length === 0) cancelAnimationFrame(frame);
  };
}

/** What is drawn as markers are: poses, polygons, and what was detected in space. */

const REPLACE = { action: 3 }; // what was there before goes
const ARROW = { x: 0.3, y: 0.025, z: 0.025 }; // m
const OUTLINE = 0.03; // m
const LETTER = 0.45; // m

const SPREAD = 0.618; // of the circle of hues between two neighbours, so that these differ

/** The colour of a class, always the same one: red, green and blue up to 1. */
export function hueOf(label: string): readonly [number, number, number] {
  let sum = 0;
  for (const letter of label) sum = (sum * 31 + letter.codePointAt(0)!) % 100_003;
  const part = (from: number): number => {
    const at = (from + ((sum * SPREAD) % 1) * 12) % 12;
    return 0.62 - 0.38 * Math.max(-1, Math.min(at - 3, 9 - at, 1));
  };
  return [part(0), part(8), part(4)];
}

/** The most likely class of a detection, and how sure it is (0 to 1), by either version of `vision_msgs`. */
export function classOf(detection: any): { label: string; score: number | undefined } {
  let best: { label: string; score: number | undefined } = { label: "", score: undefined };
  for (const one of Array.isArray(detection?.results) ? detection.results : []) {
    const { class_id, id, score } = one?.hypothesis ?? one ?? {};
    const sure = Number.isFinite(score) ? (score as number) : undefined;
    if (best.label === "" || (sure ?? -1) > (best.score ?? -1)) best = { label: String(class_id ?? id ?? "").slice(0, 60), score: sure };
  }
  return best;
}

/** A class and its score in words. */
export function caption({ label, score }: { label: string; score: number | undefined }): string {
  return [label || "unknown", score !== undefined && `${Math.round(score * 100)} %`].filter(Boolean).join(" ");
}

/** Poses of a `PoseArray` as arrows. */
export function posesAsMarkers(value: any): any {
  if (!Array.isArray(value?.poses)) throw new Error("it has no poses");
  const { header } = value;
  return { markers: [REPLACE, ...value.poses.map((pose: any, id: number) => ({ header, id, type: 0, pose, scale: ARROW, color: { r: 0.82, g: 0.4, b: 0.85, a: 1 } }))] };
}

/** The outline of a `PolygonStamped`. */
export function polygonAsMarkers(value: any): any {
  const points = value?.polygon?.points;
  if (!Array.isArray(points)) throw new Error("it has no points");
  return { markers: [REPLACE, { header: value.header, type: 4, points: [...points, ...points.slice(0, 1)], scale: { x: OUTLINE }, color: { r: 0.25, g: 0.75, b: 0.5, a: 1 } }] };
}

const EDGES = [0, 1, 1, 3, 3, 2, 2, 0, 4, 5, 5, 7, 7, 6, 6, 4, 0, 4, 1, 5, 2, 6, 3, 7]; // between corners by their bits

/** The boxes of a `Detection3DArray`, each with its class and score; their namespaces are the classes. */
export function detectionsAsMarkers(value: any): any {
  if (!Array.isArray(value?.detections)) throw new Error("it has no detections");
  const markers: any[] = [REPLACE];
  value.detections.forEach((one: any, id: number) => {
    const header = one?.header?.frame_id ? one.header : value.header;
    const told = classOf(one);
    const { center, size } = one?.bbox ?? {};
    const { x = NaN, y = NaN, z = NaN } = size ?? {};
    const [r, g, b] = hueOf(told.label);
    const same = { header, ns: told.label || "unknown", pose: center, color: { r, g, b, a: 1 } };
    const corner = (at: number): any => ({ x: at & 1 ? x / 2 : -x / 2, y: at & 2 ? y / 2 : -y / 2, z: at & 4 ? z / 2 : -z / 2 });
    markers.push({ ...same, id, type: 5, scale: { x: Math.min(x, y, z) < 0 ? -1 : OUTLINE }, points: EDGES.map(corner) });
    const { position } = center ?? {};
    const top = { position: { ...position, z: (position?.z ?? 0) + z / 2 + LETTER } };
    if (Math.min(x, y, z) >= 0) markers.push({ ...same, id: -1 - id, type: 9, pose: top, scale: { z: LETTER }, text: caption(told) });
  });
  return { markers };
}

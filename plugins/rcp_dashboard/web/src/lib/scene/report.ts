import { Matrix4, type Object3D, Vector3 } from "three";

import type { Body, Model } from "./body.ts";
import type { Colouring } from "./cloud.ts";
import type { Grid } from "./grid.ts";
import type { Dots } from "./layers.ts";
import type { MarkerLayer } from "./markerlayer.ts";

export const LAYERS = ["map", "costmap", "scan", "cloud", "path", "pose", "poses", "polygon", "markers", "detections", "trail", "frames", "robot"] as const;
export type Layer = (typeof LAYERS)[number];
/** Those that the scene draws itself, of no single source. */
export type Source = Exclude<Layer, "trail" | "frames" | "robot">;

/** What one source brings to the scene, as the page tells it. */
export interface Told {
  layer: Layer;
  path: string;
  frame: string;
  /** Points, cells, places or links. */
  count: number;
  /** Its middle in the fixed frame, metres. */
  at: [number, number, number] | undefined;
  by?: Colouring;
  problem?: string;
  /** Whether it is switched on, beside its layer. */
  shown: boolean;
  /** Of markers, their namespaces. */
  namespaces?: Namespace[];
  /** Of a robot, its links. */
  links?: Spot[];
}

export interface Namespace {
  name: string;
  count: number;
  shown: boolean;
}

export interface Spot {
  name: string;
  at: [number, number, number];
}

/** What is drawn of one source. */
export interface Item {
  layer: Layer;
  body: Body;
  frame: string | undefined;
  object: Object3D;
  count: number;
  /** Of points: they stay where they were measured, while all else moves with its frame. */
  dots?: Dots;
  grid?: Grid;
  markers?: MarkerLayer;
  fresh: boolean;
  placed: boolean;
  problem?: string;
}

/** Tell what is drawn, and where in the fixed frame. */
export function report(fixed: string, bodies: Map<string, Body>, items: Map<string, Item>, problems: Map<string, string>, hidden: ReadonlySet<string>): Told[] {
  const made: Told[] = [];
  for (const [path, item] of items) {
    const shown = !hidden.has(path);
    if (item.markers) {
      made.push(markersOf(path, item, item.markers, fixed, problems.get(path), shown));
      continue;
    }
    const frame = item.frame ?? "";
    const one: Told = { layer: item.layer, path, frame, count: item.count, at: item.placed ? placeOf(item) : undefined, shown };
    if (item.dots) one.by = item.dots.by;
    const problem = problems.get(path) ?? (item.placed ? undefined : `no transform from ${frame || "the robot"} to ${fixed}`);
    made.push(problem ? { ...one, problem } : one);
  }
  for (const [space, body] of bodies) {
    for (const name of body.frames.names) {
      const at = body.frames.between(name, fixed);
      made.push({ layer: "frames", path: space ? `${space}: ${name}` : name, frame: name, count: 1, at: at && originOf(at), shown: true });
    }
    for (const [path, model] of body.models) {
      const problem = problems.get(path) ?? model.problems.map(([uri, why]) => `${uri}: ${why}`).join("\n");
      const root = model.object.visible ? model.object.matrix : undefined;
      const links = root ? spotsOf(model, root) : [];
      made.push({ layer: "robot", path, frame: model.root, count: model.links.length, at: root && originOf(root), links, shown: true, ...(problem && { problem }) });
    }
  }
  for (const [path, problem] of problems)
    if (!made.some((one) => one.path === path)) made.push({ layer: "robot", path, frame: "", count: 0, at: undefined, problem, shown: true });
  return made;
}

const MOST_LINES = 6; // of what is wrong with one source
const MOST_NAMESPACES = 100;

function markersOf(path: string, { layer, count }: Item, markers: MarkerLayer, fixed: string, wrong: string | undefined, shown: boolean): Told {
  const { middle, frames, namespaces } = markers;
  const problems = [...(wrong ? [wrong] : []), ...markers.problems(fixed)];
  const more = problems.length - MOST_LINES;
  const told = [...problems.slice(0, MOST_LINES), ...(more > 0 ? [`and ${more} more problems`] : [])].map((one) => one.slice(0, 300)).join("\n");
  const names = [...namespaces].sort(([a], [b]) => a.localeCompare(b)).slice(0, MOST_NAMESPACES);
  return {
    layer,
    path,
    frame: frames.slice(0, 3).join(", "),
    count,
    at: middle && triple(middle),
    shown,
    ...(told && { problem: told }),
    namespaces: names.map(([name, size]) => ({ name, count: size, shown: !markers.hidden.has(name) })),
  };
}

function placeOf(item: Item): [number, number, number] {
  const at = item.dots ? item.dots.middle() : new Vector3();
  return triple(at.applyMatrix4(item.object.matrix));
}

const originOf = (at: Matrix4): [number, number, number] => triple(new Vector3().setFromMatrixPosition(at));

function spotsOf(model: Model, root: Matrix4): Spot[] {
  return model.links.map((name) => ({ name, at: originOf(new Matrix4().multiplyMatrices(root, model.link(name)!)) }));
}

const triple = ({ x, y, z }: Vector3): [number, number, number] => [x, y, z];

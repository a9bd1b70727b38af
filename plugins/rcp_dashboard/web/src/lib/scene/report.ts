import { Matrix4, type Object3D, Vector3 } from "three";

import type { Body, Model } from "./body.ts";
import type { Colouring } from "./cloud.ts";
import type { Grid } from "./grid.ts";
import type { Dots } from "./layers.ts";

export type Layer = "map" | "scan" | "cloud" | "path" | "pose" | "trail" | "frames" | "robot";
export const LAYERS: Layer[] = ["map", "scan", "cloud", "path", "pose", "trail", "frames", "robot"];

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
  /** Of a robot, its links. */
  links?: Spot[];
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
  fresh: boolean;
  placed: boolean;
  problem?: string;
}

/** Tell what is drawn, and where in the fixed frame. */
export function report(fixed: string, bodies: Map<string, Body>, items: Map<string, Item>, problems: Map<string, string>): Told[] {
  const made: Told[] = [];
  for (const [path, item] of items) {
    const frame = item.frame ?? "";
    const one: Told = { layer: item.layer, path, frame, count: item.count, at: item.placed ? placeOf(item) : undefined };
    if (item.dots) one.by = item.dots.by;
    const problem = problems.get(path) ?? (item.placed ? undefined : `no transform from ${frame || "the robot"} to ${fixed}`);
    made.push(problem ? { ...one, problem } : one);
  }
  for (const [space, body] of bodies) {
    for (const name of body.frames.names) {
      const at = body.frames.between(name, fixed);
      made.push({ layer: "frames", path: space ? `${space}: ${name}` : name, frame: name, count: 1, at: at && originOf(at) });
    }
    for (const [path, model] of body.models) {
      const problem = problems.get(path) ?? model.problems.map(([uri, why]) => `${uri}: ${why}`).join("\n");
      const root = model.object.visible ? model.object.matrix : undefined;
      const links = root ? spotsOf(model, root) : [];
      made.push({ layer: "robot", path, frame: model.root, count: model.links.length, at: root && originOf(root), links, ...(problem && { problem }) });
    }
  }
  for (const [path, problem] of problems)
    if (!made.some((one) => one.path === path)) made.push({ layer: "robot", path, frame: "", count: 0, at: undefined, problem });
  return made;
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

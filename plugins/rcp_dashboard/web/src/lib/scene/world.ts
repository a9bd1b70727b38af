import type { Group, Matrix4, Object3D } from "three";

import type { Place } from "../goal.ts";
import { past } from "../past.svelte.ts";
import { type Pose, poseOf } from "../shapes.ts";
import { detectionsAsMarkers, polygonAsMarkers, posesAsMarkers } from "./asmarkers.ts";
import { Body, type Goal, type Model } from "./body.ts";
import { discard } from "./discard.ts";
import { cloudPoints, type Colouring, scanPoints } from "./cloud.ts";
import { drawable } from "./frames.ts";
import { Grid } from "./grid.ts";
import { Dots, goalMark, pathLine, poseArrow } from "./layers.ts";
import { MarkerLayer } from "./markerlayer.ts";
import type { Fetch } from "./meshes.ts";
import { Names } from "./names.ts";
import { type Item, type Layer, report, type Source, type Told } from "./report.ts";
import type { View } from "./view.ts";

const FIXED = ["map", "world", "earth", "odom"];
/** What is drawn as markers are, and how it is made of a value. */
const AS_MARKERS: Partial<Record<Layer, (value: any) => any>> = { markers: (value) => value, poses: posesAsMarkers, polygon: polygonAsMarkers, detections: detectionsAsMarkers };

/** The robots of one backend and what they perceive, in one frame that is taken to stand still. */
export class World {
  follow = false;
  /** The frame that stands still; undefined takes the usual one. */
  wanted: string | undefined;
  colouring: Colouring = "auto";
  fixed = "map";
  /** Where the first robot is, in the fixed frame. */
  place: Matrix4 | undefined;
  readonly #view: View;
  readonly #bodies = new Map<string, Body>();
  readonly #items = new Map<string, Item>();
  readonly #problems = new Map<string, string>();
  readonly #goal: Group = goalMark();
  readonly #hidden = new Set<Layer>();
  /** Sources that are switched off. */
  readonly #off = new Set<string>();
  /** Grids that were put on top of others, the topmost last. */
  #raised: string[] = [];
  readonly #names: Names;
  /** Gets the files that a source's meshes are in. */
  fetch: (path: string) => Fetch | undefined = () => undefined;
  #dark = true;
  #opacity = 0.7;

  constructor(view: View) {
    this.#view = view;
    this.#names = new Names(view);
    this.#goal.visible = false;
    view.add(this.#goal);
    view.before = () => this.#settle();
  }

  body(space: string): Body {
    let found = this.#bodies.get(space);
    if (!found) {
      this.#bodies.set(space, (found = new Body()));
      for (const thing of [found.stand, found.trail.object, found.drop.object]) this.#view.add(thing);
    }
    return found;
  }

  /** The robot without a space of its own, or else the first that tells where it is. */
  get #first(): Body | undefined {
    const all = [this.#bodies.get(""), ...this.#bodies.values()];
    return all.find((one) => one && (one.frames.names.length > 0 || one.pose));
  }

  /** All frames that points can be taken into. */
  get frames(): string[] {
    const bodies = [...this.#bodies.values()];
    return [...new Set(bodies.flatMap((one) => [...one.frames.names, ...(one.pose ? [one.pose.frame] : [])]))].sort();
  }

  /** Take a value of a source; whatever is wrong with it is told, and the last one stays. */
  take(layer: Source, space: string, path: string, value: any): void {
    try {
      const item = this.#items.get(path) ?? this.#make(layer, space, path);
      item.frame = value.header?.frame_id ?? value.frame_id;
      this.#fill(item, value);
      item.fresh = true;
      this.#problems.delete(path);
    } catch (error) {
      this.#problems.set(path, `cannot be drawn: ${(error as Error).message}`);
    }
    this.#view.changed();
  }

  #make(layer: Layer, space: string, path: string): Item {
    const item: Item = { layer, body: this.body(space), frame: undefined, object: undefined as never, count: 0, fresh: true, placed: false };
    if (layer === "scan") item.dots = new Dots(0xff5d5d, 3);
    if (layer === "cloud") item.dots = new Dots(0x36b8c4, 2);
    if (item.dots) this.#replace(item, item.dots.object);
    if (AS_MARKERS[layer]) item.markers = new MarkerLayer(() => this.#view.changed(), () => this.fetch(path), () => past.at ?? Date.now());
    if (item.markers) this.#replace(item, item.markers.object);
    this.#items.set(path, item);
    return item;
  }

  #fill(item: Item, value: any): void {
    if (item.dots) {
      item.dots.show(item.layer === "scan" ? scanPoints(value) : cloudPoints(value));
      item.count = item.dots.count;
    } else if (item.markers) {
      item.markers.take(AS_MARKERS[item.layer]!(value));
    } else if (item.layer === "map" || item.layer === "costmap") {
      const { width, height } = value.info ?? value;
      if (!item.grid?.take(value)) {
        item.grid = new Grid(value, this.#dark, item.layer === "costmap");
        item.grid.fade(this.#opacity);
        this.#replace(item, item.grid.object);
        this.#order();
      }
      item.count = width * height;
    } else if (item.layer === "path") {
      item.count = value.poses?.length ?? 0;
      this.#replace(item, pathLine(value));
    } else {
      const told = poseOf(value);
      if (!told) throw new Error("it has no position");
      item.count = 1;
      const { position, orientation } = told;
      this.#replace(item, poseArrow(position, orientation));
    }
  }

  #replace(item: Item, object: Object3D): void {
    if (item.object) this.#drop(item.object);
    if (item.layer === "path" || item.layer === "pose") {
      // Their own place is in the object: what moves them is around it.
      object.updateMatrix();
      object.matrixAutoUpdate = false;
      object.userData["inner"] = object.matrix.clone();
    }
    item.object = object;
    this.#view.add(object);
  }

  /** Take a part of a grid that has changed. */
  patch(path: string, update: any): void {
    const grid = this.#items.get(path)?.grid;
    if (!grid) return; // what it is a part of has not come
    try {
      grid.patch(update);
    } catch (error) {
      this.#problems.set(path, `cannot be drawn: ${(error as Error).message}`);
    }
    this.#view.changed();
  }

  /** Lay costs above maps and the small above the large, except for those that were put on top. */
  #order(): void {
    const rank = ([path, { layer, grid }]: [string, Item]): [number, number] => [this.#raised.indexOf(path) + (layer === "costmap" ? 0.5 : 0), -(grid as Grid).area];
    const grids = [...this.#items].filter(([, one]) => one.grid).sort((a, b) => rank(a)[0] - rank(b)[0] || rank(a)[1] - rank(b)[1]);
    grids.forEach(([, one], at) => (one.object.renderOrder = at - grids.length));
  }

  /** Draw a grid on top of the others. */
  raise(path: string): void {
    this.#raised = [...this.#raised.filter((one) => one !== path), path];
    this.#order();
    this.#view.changed();
  }

  /** How little can be seen through what driving costs, up to 1. */
  fade(opacity: number): void {
    this.#opacity = opacity;
    for (const item of this.#items.values()) item.grid?.fade(opacity);
    this.#view.changed();
  }

  /** Take where the robot is; returns whether the value tells that. */
  pose(space: string, value: any): boolean {
    const told = poseOf(value);
    return told !== undefined && this.posed(space, { ...told, base: value.child_frame_id });
  }

  /** Take where it is, as far as it is known; returns whether it is a place. */
  posed(space: string, pose: Pose & { base?: string }, flying = false): boolean {
    if (!drawable(...Object.values(pose.position), ...Object.values(pose.orientation))) return false;
    const body = this.body(space);
    body.like(flying);
    body.pose = { ...pose, base: pose.base };
    this.#view.changed();
    return true;
  }

  /** Nothing tells any more where it is. */
  unposed(space: string): void {
    this.body(space).pose = undefined;
    this.#view.changed();
  }

  transforms(space: string, path: string, value: any): void {
    const body = this.body(space);
    body.like(false);
    try {
      body.frames.take(value, path);
      this.#problems.delete(path);
    } catch (error) {
      this.#problems.set(path, `cannot be drawn: ${(error as Error).message}`);
    }
    this.#view.changed();
  }

  joints(space: string, value: any): void {
    for (const model of this.body(space).models.values()) model.joints(value);
    this.#view.changed();
  }

  /** What follows does not lead on from what was: trails begin anew. */
  leap(): void {
    for (const body of this.#bodies.values()) body.trail.clear();
    for (const item of this.#items.values()) item.markers?.clear();
    this.#view.changed();
  }

  /** Something of it has changed by itself. */
  changed(): void {
    this.#view.changed();
  }

  /** Show a robot as it is described, and not as a box. */
  model(space: string, path: string, made: Model): void {
    const { models } = this.body(space);
    this.#remove(models.get(path));
    made.object.matrixAutoUpdate = false;
    models.set(path, made);
    this.#view.add(made.object);
  }

  #remove(model: Model | undefined): void {
    if (model) this.#drop(model.object);
    model?.dispose();
  }

  problem(path: string, told: string | undefined): void {
    if (told) this.#problems.set(path, told);
    else this.#problems.delete(path);
  }

  /** Leave out what a source has brought. */
  forget(path: string): void {
    const item = this.#items.get(path);
    item?.markers?.dispose();
    if (item?.object) this.#drop(item.object);
    this.#items.delete(path);
    this.#problems.delete(path);
    for (const body of this.#bodies.values()) {
      body.frames.forget(path);
      this.#remove(body.models.get(path));
      body.models.delete(path);
    }
    this.#view.changed();
  }

  goal(at: { x: number; y: number; yaw: number } | undefined): void {
    this.#goal.visible = at !== undefined;
    if (at) this.#goal.position.set(at.x, at.y, 0);
    if (at) this.#goal.rotation.z = at.yaw;
    this.#view.changed();
  }

  /** A place on the floor in the frame that goals of an action are told in. */
  goalFrame(at: Omit<Place, "z">, action: string): Goal {
    return this.#acting(action)?.goal(at, this.fixed) ?? { ...at, z: 0, frame: this.fixed, joined: true };
  }

  /** The robot whose space an action stands in. */
  #acting(action: string): Body | undefined {
    const below = action.split("/").slice(4).join("/");
    const near = [...this.#bodies.keys()].filter((space) => space !== "" && below.startsWith(`${space}/`)).sort((a, b) => b.length - a.length)[0];
    return near === undefined ? this.#first : this.#bodies.get(near);
  }

  show(layer: Layer, visible: boolean): void {
    if (visible) this.#hidden.delete(layer);
    else this.#hidden.add(layer);
    this.#view.changed();
  }

  /** Switch one source on or off, beside its layer. */
  showSource(path: string, visible: boolean): void {
    if (visible) this.#off.delete(path);
    else this.#off.add(path);
    this.#view.changed();
  }

  /** Switch the markers of one namespace on or off. */
  showNamespace(path: string, name: string, visible: boolean): void {
    this.#items.get(path)?.markers?.show(name, visible);
    this.#view.changed();
  }

  theme(dark: boolean): void {
    this.#dark = dark;
    for (const item of this.#items.values()) item.grid?.theme(dark);
    this.#view.changed();
  }

  colour(by: Colouring): void {
    this.colouring = by;
    for (const item of this.#items.values()) item.fresh ||= item.layer === "cloud";
    this.#view.changed();
  }

  /** Put everything where it belongs, before it is drawn. */
  #settle(): void {
    const fixed = this.#choose();
    const moved = fixed !== this.fixed;
    this.fixed = fixed;
    const first = this.#first;
    for (const body of this.#bodies.values()) {
      if (moved) body.trail.clear();
      const at = body.settle(fixed, !this.#hidden.has("robot"));
      body.trail.object.visible = !this.#hidden.has("trail");
      if (at && body === first && this.follow) this.#view.look(at.x, at.y, at.z);
    }
    this.place = first?.at(fixed);
    for (const [path, item] of this.#items) this.#settleItem(path, item, moved);
    this.#names.settle(this.#bodies, fixed, { frames: !this.#hidden.has("frames"), robots: !this.#hidden.has("robot") });
  }

  /** How many names have no room now. */
  get unnamed(): number {
    return this.#names.left;
  }

  #choose(): string {
    const known = this.frames;
    if (this.wanted && known.includes(this.wanted)) return this.wanted;
    const usual = FIXED.find((name) => known.includes(name));
    const first = this.#first;
    const base = first?.base;
    return usual ?? (base ? first.frames.root(base) : (first?.pose?.frame ?? "map"));
  }

  #settleItem(path: string, item: Item, moved: boolean): void {
    if (!item.object) return;
    const visible = !this.#hidden.has(item.layer) && !this.#off.has(path);
    if (item.markers) {
      item.markers.settle((frame) => item.body.place(frame || undefined, this.fixed), moved);
      item.count = item.layer === "detections" ? item.markers.things : item.markers.count;
      item.object.visible = visible;
      return;
    }
    if (item.fresh || moved || !item.placed || !item.dots) {
      const at = item.body.place(item.frame, this.fixed);
      item.placed = at !== undefined;
      if (at) {
        const inner = item.grid?.inner ?? item.object.userData["inner"];
        item.object.matrix.copy(inner ? at.multiply(inner) : at);
        item.object.matrixWorldNeedsUpdate = true;
        if (item.fresh || moved) item.dots?.colour(item.layer === "cloud" ? this.colouring : "plain", item.object.matrix);
        item.fresh = false;
      }
    }
    item.object.visible = item.placed && visible;
  }

  /** Give back what models hold beside what is drawn, which the view gives back. */
  dispose(): void {
    for (const item of this.#items.values()) item.markers?.dispose();
    for (const body of this.#bodies.values()) for (const model of body.models.values()) model.dispose();
  }

  /** What is drawn, and where. */
  report(): Told[] {
    return report(this.fixed, this.#bodies, this.#items, this.#problems, this.#off);
  }

  #drop(thing: Object3D): void {
    this.#view.remove(thing);
    discard(thing);
  }
}

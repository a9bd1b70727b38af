import { type AxesHelper, type Group, Matrix4, type Mesh, type Object3D } from "three";

import { poseOf } from "../shapes.ts";
import { Frames, matrixOf } from "./frames.ts";
import { axes, body, cloudPoints, Dots, goalMark, gridMesh, pathLine, scanPoints, Trail } from "./layers.ts";
import type { View } from "./view.ts";

export type Layer = "map" | "scan" | "cloud" | "trail" | "path" | "frames" | "robot";
export const LAYERS: Layer[] = ["map", "scan", "cloud", "trail", "path", "frames", "robot"];

/** One robot and what it perceives, in the frame that its pose is told in. */
export class World {
  readonly frames = new Frames();
  follow = false;
  readonly #view: View;
  #fixed = "map";
  #base = new Matrix4();
  #robot: Object3D = body();
  #trail = new Trail();
  #scans = new Map<string, Dots>();
  #clouds = new Map<string, Dots>();
  #grid: Mesh | undefined;
  #gridValue: any;
  #path: Object3D | undefined;
  #goal: Group = goalMark();
  #axes = new Map<string, AxesHelper>();
  #hidden = new Set<Layer>();
  #dark = true;

  constructor(view: View) {
    this.#view = view;
    this.#goal.visible = false;
    for (const thing of [this.#robot, this.#trail.object, this.#goal]) view.add(thing);
  }

  pose(value: any): void {
    const told = poseOf(value);
    if (!told) return;
    this.#fixed = told.frame;
    this.#base = matrixOf(told.position, told.orientation);
    this.#robot.matrix.copy(this.#base);
    this.#robot.matrixWorldNeedsUpdate = true;
    this.#trail.push(told.position.x, told.position.y, told.position.z);
    if (this.follow) this.#view.look(told.position.x, told.position.y);
    this.#view.changed();
  }

  /** What takes a frame into the fixed one; a sensor that no transform tells of is taken to sit on the robot. */
  #place(frame: string | undefined): Matrix4 {
    if (frame === undefined) return this.#base;
    return frame === this.#fixed ? new Matrix4() : (this.frames.between(frame, this.#fixed) ?? this.#base);
  }

  #dots(kept: Map<string, Dots>, path: string, layer: Layer, make: () => Dots): Dots {
    let dots = kept.get(path);
    if (!dots) {
      kept.set(path, (dots = make()));
      dots.object.visible = !this.#hidden.has(layer);
      this.#view.add(dots.object);
    }
    return dots;
  }

  scan(path: string, value: any): void {
    const { places, count } = scanPoints(value);
    this.#dots(this.#scans, path, "scan", () => new Dots(0xff5d5d, 3)).show(places, count, this.#place(value.frame_id ?? value.header?.frame_id));
    this.#view.changed();
  }

  cloud(path: string, value: any): void {
    const { places, count } = cloudPoints(value);
    this.#dots(this.#clouds, path, "cloud", () => new Dots(0x36b8c4, 2)).show(places, count, this.#place(value.frame_id ?? value.header?.frame_id));
    this.#view.changed();
  }

  map(value: any): void {
    this.#gridValue = value;
    if (this.#grid) this.#drop(this.#grid);
    this.#grid = gridMesh(value, this.#dark);
    this.#grid.visible = !this.#hidden.has("map");
    this.#view.add(this.#grid);
  }

  path(value: any): void {
    if (this.#path) this.#drop(this.#path);
    this.#path = pathLine(value);
    this.#path.visible = !this.#hidden.has("path");
    this.#view.add(this.#path);
  }

  transforms(value: any): void {
    this.frames.take(value);
    for (const name of this.frames.names) {
      const matrix = this.frames.between(name, this.#fixed);
      if (!matrix) continue;
      let mark = this.#axes.get(name);
      if (!mark) {
        this.#axes.set(name, (mark = axes(0.3)));
        mark.visible = !this.#hidden.has("frames");
        this.#view.add(mark);
      }
      mark.matrix.copy(matrix);
    }
    this.#view.changed();
  }

  goal(at: { x: number; y: number; yaw: number } | undefined): void {
    this.#goal.visible = at !== undefined;
    if (at) this.#goal.position.set(at.x, at.y, 0);
    if (at) this.#goal.rotation.z = at.yaw;
    this.#view.changed();
  }

  /** Show the robot as it is described, and not as a box. */
  model(made: Object3D): void {
    this.#view.remove(this.#robot);
    made.matrixAutoUpdate = false;
    made.matrix.copy(this.#base);
    made.visible = !this.#hidden.has("robot");
    this.#robot = made;
    this.#view.add(made);
  }

  show(layer: Layer, visible: boolean): void {
    if (visible) this.#hidden.delete(layer);
    else this.#hidden.add(layer);
    const things: Record<Layer, (Object3D | undefined)[]> = {
      map: [this.#grid],
      scan: [...this.#scans.values()].map((one) => one.object),
      cloud: [...this.#clouds.values()].map((one) => one.object),
      trail: [this.#trail.object],
      path: [this.#path],
      frames: [...this.#axes.values()],
      robot: [this.#robot],
    };
    for (const thing of things[layer]) if (thing) thing.visible = visible;
    this.#view.changed();
  }

  theme(dark: boolean): void {
    if (dark === this.#dark) return;
    this.#dark = dark;
    if (this.#gridValue) this.map(this.#gridValue);
  }

  #drop(thing: any): void {
    this.#view.remove(thing);
    thing.geometry?.dispose();
    thing.material?.map?.dispose();
    thing.material?.dispose();
  }
}

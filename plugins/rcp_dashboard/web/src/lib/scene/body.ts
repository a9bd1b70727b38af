import { Group, Matrix4, type Object3D, Vector3 } from "three";

import type { Place } from "../goal.ts";
import type { Pose } from "../shapes.ts";
import { Frames, matrixOf } from "./frames.ts";
import { body, Drop, flyer, HIGH, Trail } from "./layers.ts";

/** A robot as it is described. */
export interface Model {
  readonly object: Object3D;
  /** The link that all others hang from. */
  readonly root: string;
  readonly links: string[];
  /** Files that could not be had or drawn, each with the reason. */
  readonly problems: [uri: string, why: string][];
  dispose(): void;
  /** What takes points of a link into the root; undefined if it has no such link. */
  link(name: string): Matrix4 | undefined;
  joints(value: any): void;
  /** Move what no joint state tells of by the transforms. */
  follow(frames: Frames): void;
}

/** Where something is to go, in a frame. */
export interface Goal extends Place {
  frame: string;
  /** Whether what was pointed at could be taken into that frame. */
  joined: boolean;
}

const BASES = ["base_link", "base_footprint", "base"];

/** One robot: its frames, where it is, what it looks like. */
export class Body {
  readonly frames = new Frames();
  readonly models = new Map<string, Model>();
  readonly trail = new Trail();
  /** How high it is. */
  readonly drop = new Drop();
  readonly stand = new Group();
  pose: (Pose & { base: string | undefined }) | undefined;

  constructor() {
    this.stand.matrixAutoUpdate = false;
  }

  /** Stand in for what is not described: on wheels, or in the air. */
  like(flying: boolean): void {
    if (this.stand.children.length === 0) this.stand.add(flying ? flyer() : body());
  }

  /** The frame that stands for the robot. */
  get base(): string | undefined {
    const named = [this.pose?.base, ...BASES, ...[...this.models.values()].map((one) => one.root)];
    for (const name of named) {
      const found = name && this.frames.find(name);
      if (found) return found;
    }
    return undefined;
  }

  /** Where the robot is: by its transforms, else by its pose. */
  at(fixed: string): Matrix4 | undefined {
    const base = this.base;
    return (base === undefined ? undefined : this.frames.between(base, fixed)) ?? this.#posed(fixed);
  }

  #posed(fixed: string): Matrix4 | undefined {
    if (!this.pose) return undefined;
    const from = this.pose.frame === fixed ? new Matrix4() : this.frames.between(this.pose.frame, fixed);
    return from?.multiply(matrixOf(this.pose.position, this.pose.orientation));
  }

  /** What takes points of a frame into the fixed one; undefined where nothing tells. */
  place(frame: string | undefined, fixed: string): Matrix4 | undefined {
    if (!frame) return this.at(fixed);
    if (frame === fixed) return new Matrix4();
    const found = this.frames.between(frame, fixed);
    if (found) return found;
    for (const model of this.models.values()) {
      const link = model.link(frame);
      const root = link && this.standing(model, fixed);
      if (root) return root.multiply(link);
    }
    // Where no transform is told at all, a sensor is taken to sit on the robot.
    return this.frames.names.length === 0 && frame !== this.pose?.frame ? this.at(fixed) : undefined;
  }

  /** Where the root of a model is: by any of its links that is known of. */
  standing(model: Model, fixed: string): Matrix4 | undefined {
    const root = this.frames.between(model.root, fixed);
    if (root) return root;
    for (const name of [this.base, ...BASES]) {
      const link = name && model.link(name);
      const at = link && (this.frames.between(name, fixed) ?? this.#posed(fixed));
      if (at) return at.multiply(link.invert());
    }
    return this.at(fixed);
  }

  /** A place on the fixed frame's floor in the frame that goals are told in: the map, or what its pose is in. What flies keeps its height. */
  goal(at: Omit<Place, "z">, fixed: string): Goal {
    const frame = this.frames.find("map") ?? this.pose?.frame ?? fixed;
    const into = frame === fixed ? new Matrix4() : this.frames.between(fixed, frame);
    if (!into) return { ...at, z: 0, frame, joined: false };
    const { x, y } = new Vector3(at.x, at.y, 0).applyMatrix4(into);
    const along = new Vector3(1, 0, 0).transformDirection(into);
    const yaw = at.yaw === undefined ? undefined : at.yaw + Math.atan2(along.y, along.x);
    const high = this.at(frame)?.elements[14] ?? 0;
    return { x, y, z: Math.abs(high) > HIGH ? high : 0, yaw, frame, joined: true };
  }

  /** Move all that stands for the robot to where it is. */
  settle(fixed: string, visible: boolean): Vector3 | undefined {
    const at = this.at(fixed);
    this.stand.visible = visible && at !== undefined && this.models.size === 0;
    if (at) this.stand.matrix.copy(at);
    for (const model of this.models.values()) {
      model.follow(this.frames);
      const root = this.standing(model, fixed);
      model.object.visible = visible && root !== undefined;
      if (root) model.object.matrix.copy(root);
      model.object.matrixWorldNeedsUpdate = true;
    }
    const place = at && new Vector3().setFromMatrixPosition(at);
    this.drop.show(visible ? place : undefined);
    if (place) this.trail.push(place.x, place.y, place.z);
    return place;
  }
}

import type { Resource } from "rcp-client";

import { itemProperties, properties } from "./schema.ts";

/** What a page can make of a resource, told by the fields of its schema and not by its name. */
export type Shape =
  | "pose" | "odometry" | "scan" | "grid" | "image" | "cloud" | "geo" | "transforms" | "transform" | "joints" | "twist" | "battery" | "path" | "goal" | "urdf" | "assets" | "ned" | "attitude" | "frame"
  | "gridUpdate" | "poses" | "polygon" | "markers" | "detections" | "detections2d";

const cache = new WeakMap<Resource, Set<Shape>>();

export function shapes(resource: Resource): Set<Shape> {
  let found = cache.get(resource);
  if (!found) cache.set(resource, (found = new Set(look(resource))));
  return found;
}

function* look(resource: Resource): Generator<Shape> {
  const has = properties(resource);
  const all = (...names: string[]): boolean => names.every((name) => has.has(name));
  if (itemProperties(resource, "markers").has("ns") || all("ns", "type", "action", "scale")) return yield "markers";
  if (has.has("detections")) return yield JSON.stringify(resource.schemas?.value ?? {}).includes('"size_x"') ? "detections2d" : "detections";
  if (all("x", "y", "width", "height", "data")) return yield "gridUpdate";
  if (all("position", "orientation")) yield "pose";
  if (all("pose", "twist")) yield "odometry";
  else if (all("pose") && resource.kind === "sensor") yield "pose";
  if (all("ranges", "angle_min", "angle_increment")) yield "scan";
  if (all("resolution", "width", "height", "data") || all("info", "data")) yield "grid";
  if ((all("width", "height", "data") && !has.has("resolution") && !has.has("point_step")) || all("format", "data")) yield "image";
  if (all("point_step", "data") || (has.has("points") && !has.has("joint_names"))) yield "cloud";
  if (all("latitude", "longitude") || all("lat", "lon")) yield "geo";
  if (all("x", "y", "z", "vx", "vy", "vz") && /NED/.test(String(resource.native))) yield "ned";
  if (all("roll", "pitch", "yaw")) yield "attitude";
  if (resource.kind === "event" && all("id", "data")) yield "frame";
  if (has.has("transforms")) yield "transforms";
  if (all("transform", "child_frame_id")) yield "transform";
  if (all("name", "position") && !has.has("orientation")) yield "joints";
  if (has.has("poses")) yield itemProperties(resource, "poses").has("position") ? "poses" : "path";
  if (has.has("polygon")) yield "polygon";
  if (has.has("percentage") || (has.has("voltage") && has.has("current"))) yield "battery";
  if (resource.kind === "actuator" && (all("linear", "angular") || has.has("twist"))) yield "twist";
  if (resource.kind === "action") {
    const text = JSON.stringify(resource.schemas?.input ?? {});
    if (text.includes('"position"') || (text.includes('"pose"') && text.includes('"orientation"'))) yield "goal";
    else if (text.includes('"latitude"') || text.includes('"north"')) yield "goal";
  }
  if (resource.kind === "service" && properties(resource, "input").has("uri") && properties(resource, "output").has("media_type")) yield "assets";
  if (resource.kind !== "service" && /\/robot_description$|urdf/.test(resource.path)) yield "urdf";
}

export function ofShape(resources: Resource[], shape: Shape): Resource[] {
  return resources.filter((one) => shapes(one).has(shape));
}

/** Heading in the plane of a quaternion, counter-clockwise from x, in rad. */
export function yawOf(q: any): number {
  const { x = 0, y = 0, z = 0, w = 1 } = q ?? {};
  return Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
}

export interface Pose {
  position: { x: number; y: number; z: number };
  orientation: { x: number; y: number; z: number; w: number };
  frame: string;
}

/** The pose in a value of the shapes `pose` and `odometry`, however deep its type has it; none by what is no number. */
export function poseOf(value: any): Pose | undefined {
  let at = value;
  for (let depth = 0; depth < 3 && at && !at.position; depth++) at = at.pose;
  if (!at?.position) return undefined;
  const { x = 0, y = 0, z = 0 } = at.position;
  const { x: qx = 0, y: qy = 0, z: qz = 0, w = 1 } = at.orientation ?? {};
  if (![x, y, z, qx, qy, qz, w].every(Number.isFinite)) return undefined;
  const frame = value.frame_id ?? value.header?.frame_id ?? "map";
  return { position: { x, y, z }, orientation: { x: qx, y: qy, z: qz, w }, frame };
}

/** Where a vehicle is that tells it north, east and down, and turned so: forward, left, up in east, north, up. */
export function poseOfNed(position: any, attitude: any): Pose | undefined {
  const { x: north, y: east, z: down } = position;
  const { roll = 0, pitch = 0, yaw = 0 } = attitude ?? {};
  if (![north, east, down, roll, pitch, yaw].every(Number.isFinite)) return undefined;
  const [r, p, y] = [roll / 2, -pitch / 2, (Math.PI / 2 - yaw) / 2];
  const [cr, sr, cp, sp, cy, sy] = [Math.cos(r), Math.sin(r), Math.cos(p), Math.sin(p), Math.cos(y), Math.sin(y)];
  return {
    position: { x: east, y: north, z: -down },
    orientation: {
      x: sr * cp * cy - cr * sp * sy,
      y: cr * sp * cy + sr * cp * sy,
      z: cr * cp * sy - sr * sp * cy,
      w: cr * cp * cy + sr * sp * sy,
    },
    frame: "origin",
  };
}

/** Position and heading in a transform of 16 numbers, column by column. */
export function placeOf(m: ArrayLike<number>): { x: number; y: number; z: number; yaw: number } {
  return { x: m[12] as number, y: m[13] as number, z: m[14] as number, yaw: Math.atan2(m[1] as number, m[0] as number) };
}

import type { Resource } from "rcp-client";

import { initial, main, resolve } from "./schema.ts";

export interface Place {
  x: number;
  y: number;
  /** On the ground, or as high as what flies. */
  z: number;
  /** Undefined where any heading will do. */
  yaw: number | undefined;
}

/** The input of an action that goes to a place, by the fields of its schema; undefined if it does not. */
export function goalInput(resource: Resource, place: Place, frame: string): unknown {
  const root = resource.command_schema ?? resource.schemas?.input;
  if (!root) return undefined;
  const whole = main(resolve(root, root), root).schema;
  const has = (name: string): boolean => whole["properties"]?.[name] !== undefined;
  const made = initial(whole, root) as Record<string, unknown>;
  const position = { x: place.x, y: place.y, z: place.z };
  const half = (place.yaw ?? 0) / 2;
  const orientation = { x: 0, y: 0, z: Math.sin(half), w: Math.cos(half) };
  if (has("position")) {
    const heading = place.yaw === undefined ? {} : has("yaw") ? { yaw: place.yaw } : { orientation };
    return { ...made, position, ...heading };
  }
  if (has("north") && has("east")) {
    const yaw = place.yaw === undefined ? {} : has("yaw") ? { yaw: Math.atan2(Math.cos(place.yaw), Math.sin(place.yaw)) } : {};
    return { ...made, north: place.y, east: place.x, ...yaw };
  }
  if (!has("pose")) return undefined;
  const text = JSON.stringify(resolve(whole["properties"]["pose"], root));
  const pose = { position, orientation };
  if (text.includes('"header"')) return { ...made, pose: { header: { frame_id: frame }, pose } };
  return { ...made, pose: text.includes('"frame_id"') ? { ...pose, frame_id: frame } : pose };
}

import type { Resource, Schema } from "rcp-client";

import { main, resolve } from "./schema.ts";
import { numberTyped } from "./typed.ts";
import { units } from "./units.svelte.ts";

/** One number that an actuator takes, between bounds. */
export interface Joint {
  /** Of the field; empty where the value itself is the number. */
  field: string;
  name: string;
  least: number;
  most: number;
  unit: string;
}

/** An actuator of joints: places to go to, or speeds that spring back to 0 when they are let go. */
export interface Joints {
  resource: Resource;
  kind: "place" | "speed";
  joints: Joint[];
}

const PLACES = new Set(["rad", "deg", "m"]);
const SPEEDS = new Set(["rad/s", "m/s"]);

function joint(schema: Schema, root: Schema, field: string, name: string): Joint | undefined {
  const one = main(resolve(schema, root), root).schema;
  const [least, most, unit] = [one["minimum"], one["maximum"], one["unit"]];
  if (!["number", "integer"].includes(one["type"]) || typeof least !== "number" || typeof most !== "number" || least >= most) return undefined;
  return PLACES.has(unit) || SPEEDS.has(unit) ? { field, name, least, most, unit } : undefined;
}

/** What of an actuator can be set by sliders, told by its schema; torques and the like are left to Explore. */
export function jointsOf(resource: Resource): Joints | undefined {
  const root = resource.command_schema ?? resource.schemas?.value;
  if (resource.kind !== "actuator" || !resource.operations.includes("write") || !root) return undefined;
  const whole = main(resolve(root, root), root).schema;
  const parts = Object.entries((whole["properties"] ?? {}) as Record<string, Schema>);
  const name = resource.path.split("/").slice(4).join(" ");
  const found = whole["type"] === "object" ? parts.map(([key, one]) => joint(one, root, key, key)) : [joint({ unit: resource.unit, ...whole }, root, "", name)];
  // A field that is no joint (yaw_rate beside x, thrust beside roll) makes it something else.
  if (found.length === 0 || found.some((one) => one === undefined || one.unit !== found[0]?.unit)) return undefined;
  const kind = SPEEDS.has(found[0]?.unit ?? "") ? "speed" : "place";
  // A speed that nothing ends when the hand is gone is none to be set by a slider.
  return kind === "speed" && resource.safe === undefined ? undefined : { resource, kind, joints: found as Joint[] };
}

/** From end to end, in the unit that is shown. */
const rangeOf = ({ least, most, unit }: Joint): number => units.shown(most, unit) - units.shown(least, unit);

/** With how many decimals a place of a joint is told: a gripper moves by less than an arm. */
export function digitsOf(joint: Joint): number {
  const range = rangeOf(joint);
  return range >= 1 ? 2 : range >= 0.1 ? 3 : 4;
}

/** Where a joint is to go that is typed in the unit that is shown: as the actuator takes it, within what it takes. */
export function typedTarget(text: string, joint: Joint): number | undefined {
  const found = numberTyped(text);
  if (Number.isNaN(found)) return undefined;
  const [least, most] = [units.shown(joint.least, joint.unit), units.shown(joint.most, joint.unit)];
  // A bound may be typed as it is shown, which is rounded.
  const near = 0.5 * 10 ** -digitsOf(joint) + 1e-9;
  if (found < least - near || found > most + near) return undefined;
  return Math.min(joint.most, Math.max(joint.least, units.meant(found, joint.unit)));
}

/** Round steps for jogging, in the unit that is shown: about 1/500, 1/50 and 1/10 of the widest range. */
export function stepsOf(joints: Joint[]): number[] {
  const range = Math.max(...joints.map(rangeOf));
  return [500, 50, 10].map((parts) => {
    const size = range / parts;
    const unit = 10 ** Math.floor(Math.log10(size));
    const factor = [1, 2, 5, 10].find((one) => one * unit >= size * 0.75) as number;
    return Number((factor * unit).toPrecision(1));
  });
}

import type { Resource, Schema } from "rcp-client";

import { main, resolve } from "./schema.ts";
import { isHold } from "./stops.ts";

/** What robots commonly can do at the press of a button, by the last part of its path; in the order of the buttons. */
const known = (): [name: RegExp, label: string, guarded?: true][] => [
  [/^enable$/, "Enable"],
  [/^disable$/, "Disable"],
  [/^arm$/, "Arm", true],
  [/^disarm$/, "Disarm", true],
  [/^take_?off$/, "Take off", true],
  [/^land$/, "Land"],
  [/^(rtl|return_to_(home|launch))$/, "Return"],
  [/^(hold|pause_motion|stop)$/, "Hold"],
  [/^home$/, "Home", true],
  [/^dock$/, "Dock", true],
  [/^undock$/, "Undock", true],
  [/^stand(_up)?$/, "Stand", true],
  [/^sit(_down)?$/, "Sit"],
  [/^set_(flight_)?mode$/, "Mode"],
  [/^clear_faults$/, "Clear faults"],
];

/** The one thing that is to be filled in before a button is pressed. */
export interface Field {
  name: string;
  unit: string;
  options: unknown[];
  number: boolean;
  initial: unknown;
}

export interface Button {
  resource: Resource;
  label: string;
  field: Field | undefined;
  /** Whether it sets a robot in motion, or its motors free: then it has to be held. */
  guarded: boolean;
}

function inputOf(resource: Resource): { fields: [string, Schema][]; required: string[]; root: Schema } {
  const root = resource.command_schema ?? resource.schemas?.input;
  if (!root) return { fields: [], required: [], root: {} };
  const whole = main(resolve(root, root), root).schema;
  const object = resolve(whole, root);
  return { fields: Object.entries((object["properties"] ?? {}) as Record<string, Schema>), required: object["required"] ?? [], root };
}

function fieldOf(resource: Resource): Field | undefined {
  const { fields, root } = inputOf(resource);
  const [only] = fields;
  if (!only || fields.length > 1) return undefined;
  const [name, schema] = only;
  const one = main(resolve(schema, root), root).schema;
  const number = one["type"] === "number" || one["type"] === "integer";
  if (!number && one["type"] !== "string") return undefined;
  const options: unknown[] = one["enum"] ?? one["examples"] ?? [];
  return { name, unit: one["unit"] && one["unit"] !== "1" ? one["unit"] : "", options, number, initial: one["default"] ?? options[0] ?? "" };
}

/** The buttons of a robot: those of a group of joints in place of those of each of its joints. */
export function buttonsOf(resources: Resource[], groups: string[]): Button[] {
  const holds = resources.some(isHold); // that one has a button of its own, beside the stop
  const able = resources.filter(
    (one) => one.operations.includes("execute") && (one.kind === "action" || one.kind === "service") && !(holds && /\/hold$/.test(one.path)),
  );
  return known().flatMap(([name, label, guarded]) => {
    const found = able.filter((one) => name.test(one.path.split("/").at(-1) ?? ""));
    const of = (one: Resource): string => one.path.split("/").slice(4, -1).join(" ");
    const grouped = found.filter((one) => groups.includes(of(one)));
    return (grouped.length ? grouped : found).flatMap((resource) => {
      const field = fieldOf(resource);
      const { required } = inputOf(resource);
      // What needs more than one thing filled in has its form on Explore.
      if (required.length > (field ? 1 : 0)) return [];
      return [{ resource, label: of(resource) ? `${label} ${of(resource)}` : label, field, guarded: guarded === true }];
    });
  });
}

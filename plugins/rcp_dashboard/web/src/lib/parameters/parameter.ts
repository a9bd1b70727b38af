/** Parameters of a robot as a person edits them, made from the resources that it declares. */
import type { Resource, Schema } from "rcp-client";

import type { Robot } from "../robots.ts";
import { main, resolve, unitOf } from "../schema.ts";
import { boxed } from "../typed.ts";

/** How a value is entered: `json` is for whatever has parts. */
export type Entry = "number" | "integer" | "boolean" | "choice" | "text" | "json";

export interface Parameter {
  path: string;
  /** Its path below `param/`, without the robot's own place. */
  name: string;
  /** What the device calls it. */
  own: string | undefined;
  group: string;
  resource: Resource;
  schema: Schema;
  entry: Entry;
  unit: string;
  /** What the device enforces. */
  low: number | undefined;
  high: number | undefined;
  /** What its makers recommend; the device may take other values. */
  recommended: [number, number] | undefined;
  /** undefined: not known. */
  default: unknown;
  /** What single values mean, and single bits by their number. */
  meanings: Map<string, string>;
  bits: Map<number, string>;
  /** Values to choose from. */
  choices: unknown[];
  restart: boolean;
  writable: boolean;
  /** In small letters, for the search. */
  text: string;
}

const other = (): string => "Other"; // the group of those that belong to none
const WIDE = 2 ** 31 - 1; // bounds of a type that tell nothing

/** The parameters of a robot in the order of their names, as far as the role may use them; `defaults` are those that the robot has told, by name. */
export function parametersOf(robot: Robot, defaults: ReadonlyMap<string, unknown> = new Map()): Parameter[] {
  const found = robot.resources.filter((one) => one.kind === "param").map((one) => parameterOf(one, robot.place));
  for (const one of found) one.default = defaults.get(one.name) ?? one.default;
  found.sort((a, b) => NAMES.compare(a.name, b.name));
  const counts = new Map<string, number>();
  for (const { group } of found) counts.set(group, (counts.get(group) ?? 0) + 1);
  // A group of one is none.
  for (const one of found) if (counts.get(one.group) === 1) one.group = other();
  return found;
}

const NAMES = new Intl.Collator(undefined, { numeric: true });

/** The groups with the number of parameters in each, in order. */
export function groupsOf(parameters: Parameter[]): [group: string, count: number][] {
  const counts = new Map<string, number>();
  for (const { group } of parameters) counts.set(group, (counts.get(group) ?? 0) + 1);
  return [...counts].sort(([a], [b]) => Number(a === other()) - Number(b === other()) || NAMES.compare(a, b));
}

function parameterOf(resource: Resource, place: string | undefined): Parameter {
  const root = resource.command_schema ?? resource.schemas?.value ?? {};
  const whole = resolve(root, root);
  const one = main(whole, root).schema;
  const about = { ...whole, ...one };
  const name = nameOf(resource.path, place);
  const own = resource.meta?.["parameter"];
  const range = about["range"];
  const unit = unitOf(resource);
  return {
    path: resource.path,
    name,
    own: typeof own === "string" ? own : undefined,
    group: groupOf(name),
    resource,
    schema: root,
    entry: entryOf(one),
    unit,
    low: one["minimum"] ?? one["exclusiveMinimum"],
    high: one["maximum"] ?? one["exclusiveMaximum"],
    recommended: Array.isArray(range) && range.length === 2 && range.every((end) => typeof end === "number") ? (range as [number, number]) : undefined,
    default: about["default"] ?? resource.meta?.["default"] ?? undefined,
    meanings: new Map(Object.entries((about["values"] ?? {}) as Record<string, string>)),
    bits: new Map(Object.entries((about["bits"] ?? {}) as Record<string, string>).map(([bit, text]) => [Number(bit), text])),
    choices: one["enum"] ?? [],
    restart: about["restart"] === true,
    writable: resource.operations.includes("write"),
    text: `${name} ${resource.description} ${unit}`.toLowerCase(),
  };
}

/** What is before the names of the parameters that a service such as `service/drone/param/defaults` is about. */
export function prefixOf(service: Resource, place: string | undefined): string {
  const within = nameOf(service.path, place).split("/").slice(0, -2);
  return within.map((one) => `${one}/`).join("");
}

function nameOf(path: string, place: string | undefined): string {
  const below = path.split("/").slice(4); // "", tenant, its name, param
  if (place !== undefined && below.length > 1 && below[0] === place) below.shift();
  return below.join("/");
}

/** The node or record that it is of, else the first word of its name. */
function groupOf(name: string): string {
  const parts = name.split("/");
  if (parts.length > 1) return parts.slice(0, -1).join("/");
  const [dotted] = name.split(".");
  if (dotted !== undefined && dotted !== name) return dotted;
  const [word] = name.split("_");
  return word !== undefined && word !== "" && word !== name ? word : other();
}

function entryOf(schema: Schema): Entry {
  if (Array.isArray(schema["enum"])) return "choice";
  switch (schema["type"]) {
    case "number":
    case "integer":
    case "boolean":
      return schema["type"];
    case "string":
      return "text";
    default:
      return "json";
  }
}

/** The range as people read it: what is recommended, else what is enforced. */
export function rangeText({ recommended, low, high }: Parameter): string {
  if (recommended) return `${boxed(recommended[0])} … ${boxed(recommended[1])}`;
  const least = low !== undefined && low > -WIDE ? low : undefined;
  const most = high !== undefined && high < WIDE ? high : undefined;
  if (least !== undefined && most !== undefined) return `${boxed(least)} … ${boxed(most)}`;
  if (least !== undefined) return `≥ ${boxed(least)}`;
  return most !== undefined ? `≤ ${boxed(most)}` : "";
}

/** Whether a parameter has all of these words. */
export function matches(one: Parameter, words: string[]): boolean {
  return words.every((word) => one.text.includes(word));
}

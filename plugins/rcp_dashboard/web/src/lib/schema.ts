import { Validator } from "@cfworker/json-schema";
import type { Resource, Schema } from "rcp-client";

import { boxed, numberTyped, pointed } from "./typed.ts";

/** A part of a schema with its references resolved against the whole. */
export function resolve(schema: Schema, root: Schema): Schema {
  let found = schema;
  for (let depth = 0; found["$ref"] && depth < 16; depth++) {
    const { $ref, ...rest } = found;
    const parts = ($ref as string).replace(/^#\//, "").split("/");
    const target = parts.reduce<any>((at, part) => at?.[part.replaceAll("~1", "/").replaceAll("~0", "~")], root);
    found = { ...(target ?? {}), ...rest };
  }
  return found;
}

/** Alternatives of a schema; one that may be null has `null` among them. */
export function alternatives(schema: Schema): Schema[] {
  return (schema["anyOf"] ?? schema["oneOf"] ?? []) as Schema[];
}

/** The one alternative that a person fills in, where the others are null or a spelling of odd numbers. */
export function main(schema: Schema, root: Schema): { schema: Schema; nullable: boolean } {
  const options = alternatives(schema).map((one) => resolve(one, root));
  if (options.length === 0) return { schema, nullable: schema["type"] === "null" };
  const nullable = options.some((one) => one["type"] === "null");
  const real = options.filter((one) => one["type"] !== "null");
  const numbers = real.filter((one) => one["type"] === "number" || one["type"] === "integer");
  const pick = numbers[0] ?? (real.length === 1 ? real[0] : undefined);
  const { anyOf: _, oneOf: __, ...around } = schema;
  return { schema: pick ? { ...around, ...pick } : schema, nullable };
}

/** A value to begin with: the default, the least that is valid, or nothing. */
export function initial(schema: Schema, root: Schema): unknown {
  const whole = resolve(schema, root);
  if ("default" in whole) return structuredClone(whole["default"]);
  if ("const" in whole) return whole["const"];
  const { schema: one, nullable } = main(whole, root);
  if (nullable) return null;
  if (one["enum"]) return one["enum"][0];
  switch (one["type"]) {
    case "object": {
      const made: Record<string, unknown> = {};
      const required: string[] = one["required"] ?? [];
      for (const [key, part] of Object.entries((one["properties"] ?? {}) as Record<string, Schema>))
        if (required.includes(key)) made[key] = initial(part, root);
      return made;
    }
    case "array":
      return [];
    case "boolean":
      return false;
    case "number":
    case "integer":
      return Math.max(0, one["minimum"] ?? 0) <= (one["maximum"] ?? Infinity) ? Math.max(0, one["minimum"] ?? 0) : one["maximum"];
    case "string":
      return "";
    default:
      return null;
  }
}

/** A value in which nothing is chosen yet but what the schema sets by default: the rest is for a person to enter. */
export function blank(schema: Schema, root: Schema): unknown {
  const whole = resolve(schema, root);
  if ("default" in whole) return structuredClone(whole["default"]);
  if ("const" in whole) return whole["const"];
  const { schema: one, nullable } = main(whole, root);
  if (nullable) return null;
  if (one["type"] === "array") return [];
  if (one["type"] !== "object") return undefined;
  const required: string[] = one["required"] ?? [];
  const parts = Object.entries((one["properties"] ?? {}) as Record<string, Schema>).filter(([key]) => required.includes(key));
  return Object.fromEntries(parts.map(([key, part]) => [key, blank(part, root)] as const).filter(([, part]) => part !== undefined));
}

/** Fields that are required, and have not been entered. */
export function missing(value: unknown, schema: Schema, root: Schema, pointer = ""): Fault[] {
  const whole = resolve(schema, root);
  const { schema: one, nullable } = main(whole, root);
  if (value === null && nullable) return [];
  if (["number", "integer", "string", "boolean"].includes(one["type"]) || one["enum"]) return value === undefined || (value === "" && one["type"] !== "string") ? [{ pointer, message: "Enter a value." }] : [];
  if (one["type"] !== "object" || !one["properties"]) return [];
  const required: string[] = one["required"] ?? [];
  const there = (value ?? {}) as Record<string, unknown>;
  return Object.entries(one["properties"] as Record<string, Schema>).flatMap(([key, part]) =>
    required.includes(key) || (there[key] !== undefined && there[key] !== null) ? missing(there[key], part, root, `${pointer}/${key}`) : [],
  );
}

/** What was typed, as a number; as the text itself where no number is just that: the gateway takes the digits of a long one. */
export function numberOf(text: string): number | string {
  const found = Number(text);
  if (text.trim() === "" || !Number.isFinite(found)) return text;
  const changed = /^\s*-?\d+\s*$/.test(text) && !Number.isSafeInteger(found) && BigInt(text) !== BigInt(found);
  return changed ? text.trim() : found;
}

/** What was typed where a number is wanted; as the text itself where it is none, or may be understood as two, or keeps its digits only as text. */
export function numberEntered(text: string): number | string {
  const bare = pointed(text).replace(/^\+/, "");
  if (/^-?\d+$/.test(bare)) return numberOf(bare);
  const found = numberTyped(text);
  return Number.isNaN(found) ? text.trim() : found;
}

/** Read JSON with every number as it is written. */
export function parse(text: string): unknown {
  return (JSON.parse as any)(text, (_: string, value: unknown, context?: { source?: string }) => {
    if (typeof value !== "number" || Math.abs(value) <= Number.MAX_SAFE_INTEGER) return value;
    if (context?.source === undefined) throw new Error(`This browser cannot represent ${value} exactly: put it in quotes.`);
    return numberOf(context.source);
  });
}

export interface Fault {
  /** JSON Pointer of the field. */
  pointer: string;
  message: string;
}

/** Check a value before it is sent; the gateway checks again. */
export function faults(value: unknown, schema: Schema): Fault[] {
  const { $id: _, ...anonymous } = schema;
  const result = new Validator(anonymous, "2020-12", false).validate(value);
  if (result.valid) return [];
  const leaves = result.errors.filter((error) => !["properties", "$ref", "anyOf", "items", "allOf", "oneOf"].includes(error.keyword));
  const seen = new Set<string>();
  return (leaves.length ? leaves : result.errors)
    .map((error) => ({ pointer: error.instanceLocation.replace(/^#/, ""), message: inWords(error) }))
    .filter(({ pointer, message }) => !seen.has(pointer + message) && seen.add(pointer + message));
}

/** Whether a text is a value where a number is wanted, such as NaN, or the digits of a long one. */
export function spells(text: string, schema: Schema, root: Schema): boolean {
  const texts = alternatives(resolve(schema, root)).map((one) => resolve(one, root)).filter((one) => one["enum"] || one["type"] === "string");
  return texts.some((one) => faults(text, one).length === 0);
}

/** What is wrong with a number in words; the rest is told as the checker tells it. */
function inWords({ keyword, error }: { keyword: string; error: string }): string {
  const bound = boxed(Number(/ ([-+.e\d]+)\.$/.exec(error)?.[1]));
  if (keyword === "type" && error.endsWith('Expected "number".')) return "Enter a number.";
  if (keyword === "type" && error.endsWith('Expected "integer".')) return "Enter a whole number.";
  if (keyword === "minimum") return `Enter a number of at least ${bound}.`;
  if (keyword === "maximum") return `Enter a number of at most ${bound}.`;
  if (keyword === "exclusiveMinimum") return `Enter a number above ${bound}.`;
  return keyword === "exclusiveMaximum" ? `Enter a number below ${bound}.` : error;
}

/** The properties of a resource's value, or of its input, as far as the schema tells. */
export function properties(resource: Resource, of: "value" | "input" | "output" = "value"): Set<string> {
  const root = resource.schemas?.[of];
  if (!root) return new Set();
  const whole = main(resolve(root, root), root).schema;
  return new Set(Object.keys(whole["properties"] ?? {}));
}

/** The fields of each item of a list in the value. */
export function itemProperties(resource: Resource, list: string): Set<string> {
  const root = resource.schemas?.value;
  const field = root && main(resolve(root, root), root).schema["properties"]?.[list];
  if (!field) return new Set();
  const items = main(resolve(field, root), root).schema["items"];
  return new Set(Object.keys((items && main(resolve(items, root), root).schema["properties"]) ?? {}));
}

/** The unit of a field, given by dots, or of the value itself. */
export function unitOf(resource: Resource | undefined, field = ""): string {
  const root = resource?.schemas?.value;
  if (!resource || !root) return "";
  let at = main(resolve(root, root), root).schema;
  for (const part of field === "" ? [] : field.split(".")) {
    const next = at["properties"]?.[part] ?? at["items"] ?? at["additionalProperties"];
    if (!next) return "";
    at = main(resolve(next, root), root).schema;
  }
  const unit = at["unit"] ?? (field === "" ? resource.unit : undefined) ?? "";
  return unit === "1" ? "" : unit;
}

/** The numeric fields of a value, by their dotted names; long lists are left out. */
export function numericFields(value: unknown, prefix = ""): string[] {
  if (typeof value === "number") return [prefix];
  if (typeof value === "boolean") return [prefix];
  if (value === null || typeof value !== "object") return [];
  if (Array.isArray(value) && value.length > 16) return [];
  return Object.entries(value).flatMap(([key, item]) => numericFields(item, prefix ? `${prefix}.${key}` : key));
}

/** The number at a dotted name. */
export function pick(value: unknown, field: string): number | null {
  let at: any = value;
  if (field !== "") for (const part of field.split(".")) at = at?.[part];
  if (typeof at === "boolean") return at ? 1 : 0;
  return typeof at === "number" ? at : null;
}

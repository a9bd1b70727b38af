import type { Resource } from "rcp-client";

import { unitOf } from "./schema.ts";
import { units } from "./units.svelte.ts";

const LONG = 16; // items: longer lists are not shown one by one

/** A value for people to look at: with its numbers in the units that they chose. */
export function converted(resource: Resource, value: unknown, field = ""): unknown {
  if (units.system === "metric") return value;
  if (typeof value === "number") return units.shown(value, unitOf(resource, field));
  if (value === null || typeof value !== "object" || (Array.isArray(value) && value.length > LONG)) return value;
  const parts = Object.entries(value).map(([key, item]) => [key, converted(resource, item, field ? `${field}.${key}` : key)] as const);
  return Array.isArray(value) ? parts.map(([, item]) => item) : Object.fromEntries(parts);
}

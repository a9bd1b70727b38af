/** Values of parameters: as text, from text, and whether two are the same. */
import { asSet } from "../format.ts";
import { faults, numberEntered, parse } from "../schema.ts";
import { boxed } from "../typed.ts";
import type { Parameter } from "./parameter.ts";

const FEWEST = 6; // digits of a number of 32 bits
const MOST = 10;

/** A number with as few digits as tell it from its neighbours: many devices keep 32 bits. */
export function digits(value: number): string {
  if (Number.isInteger(value) || Math.fround(value) !== value) return String(value);
  for (let count = FEWEST; count < MOST; count++) {
    const found = Number(value.toPrecision(count));
    if (Math.fround(found) === value) return String(found);
  }
  return String(value);
}

/** A value as it is shown. */
export function textOf(value: unknown): string {
  return typeof value === "number" ? asSet(Number(digits(value))) : plain(value);
}

/** A value as the box of its parameter holds it, so that it can be entered again: JSON has a point in any language. */
export function boxText({ entry }: Parameter, value: unknown): string {
  if (entry === "choice") return JSON.stringify(value ?? null);
  return entry === "number" || entry === "integer" ? textOf(value) : plain(value);
}

function plain(value: unknown): string {
  if (value === undefined || value === null) return "";
  if (typeof value === "number") return digits(value);
  return typeof value === "string" ? value : JSON.stringify(value);
}

/** Whether a device that keeps 32 bits of a number has this value; whole numbers, such as bits, are the same only if all of their digits are. */
export function same(a: unknown, b: unknown): boolean {
  if (typeof a === "number" && typeof b === "number") return a === b || (!Number.isInteger(a) && !Number.isInteger(b) && (Math.fround(a) === b || a === Math.fround(b)));
  if (typeof a !== "object" || typeof b !== "object" || a === null || b === null) return a === b;
  if (Array.isArray(a) !== Array.isArray(b)) return false;
  const [one, other] = [a, b] as [Record<string, unknown>, Record<string, unknown>];
  const keys = Object.keys(one);
  return keys.length === Object.keys(other).length && keys.every((key) => key in other && same(one[key], other[key]));
}

/** The value of a bit: that of the sign, where it has one, is negative. */
export function weightOf({ low, high }: Parameter, bit: number): number {
  const weight = 2 ** bit;
  return low === -weight && high === weight - 1 ? -weight : weight;
}

export type Entered = { value: unknown; fault?: undefined } | { fault: string };

/** Read what was entered, and check it by the schema; the gateway checks again. */
export function entered(one: Parameter, text: string): Entered {
  const found = valueOf(one, text);
  if (found.fault !== undefined) return found;
  const fault = numberFault(one, found.value) ?? faults(found.value, one.schema)[0]?.message;
  return fault === undefined ? found : { fault };
}

function valueOf({ entry }: Parameter, text: string): Entered {
  if (entry === "text") return { value: text };
  if (text.trim() === "") return { fault: "Enter a value." };
  if (entry === "boolean") return text === "true" || text === "false" ? { value: text === "true" } : { fault: "Enter true or false." };
  if (entry === "number" || entry === "integer") return { value: numberEntered(text) };
  try {
    return { value: parse(text) };
  } catch {
    return entry === "choice" ? { value: text } : { fault: "Enter a value in JSON." };
  }
}

/** What is wrong with a number, in words. */
function numberFault({ entry, low, high, schema }: Parameter, value: unknown): string | undefined {
  if (entry !== "number" && entry !== "integer") return undefined;
  if (typeof value !== "number") return faults(value, schema).length ? "Enter a number." : undefined;
  if (entry === "integer" && !Number.isInteger(value)) return "Enter a whole number.";
  if ((low === undefined || value >= low) && (high === undefined || value <= high)) return undefined;
  if (low === undefined) return `Enter a number of at most ${boxed(high as number)}.`;
  return high === undefined ? `Enter a number of at least ${boxed(low)}.` : `Enter a number from ${boxed(low)} to ${boxed(high)}.`;
}

/** Whether a value is beyond what the makers recommend. */
export function outside({ recommended }: Parameter, value: unknown): boolean {
  return recommended !== undefined && typeof value === "number" && (value < recommended[0] || value > recommended[1]);
}

/** What a value means, where that is known. */
export function meaningOf({ meanings }: Parameter, value: unknown): string {
  return typeof value === "number" ? (meanings.get(String(value)) ?? "") : "";
}

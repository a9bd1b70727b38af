/** Numbers as people type them, and as boxes to type in hold them. */
import { language } from "./language.svelte.ts";

const NUMBER = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i;
const ONE_COMMA = /^[^.,]*,[^.,]*$/;
/** Where decimals have a comma, this may as well be thousands. */
const UNSURE = /^[-+]?[1-9]\d{0,2}\.\d{3}$/;

/** What was typed, with a point where the language writes a comma. */
export function pointed(text: string): string {
  const bare = text.trim().replace("−", "-");
  return language.comma && ONE_COMMA.test(bare) ? bare.replace(",", ".") : bare;
}

/** The number that was typed; NaN where it is none, or may be understood as two: what moves a robot is not guessed. */
export function numberTyped(text: string): number {
  const plain = pointed(text);
  if (!NUMBER.test(plain) || (language.comma && UNSURE.test(text.trim()))) return Number.NaN;
  return Number.isFinite(Number(plain)) ? Number(plain) : Number.NaN;
}

/** A number as a box holds it: as the language writes it, so that it can be typed again. */
export function boxed(value: number): string {
  if (!Number.isFinite(value)) return "";
  return language.comma ? String(value).replace(".", ",") : String(value);
}

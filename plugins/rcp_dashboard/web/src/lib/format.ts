/** Numbers, times and values as people read them. */
import { language, say } from "./language.svelte.ts";

/** A number as the language writes it. For people: what is read again, by the page or by others, has a point. */
const local = (text: string): string => (language.comma ? text.replace(".", ",") : text);

/** A whole number, with thousands apart. */
export function amount(count: number): string {
  return count.toLocaleString(language.locale);
}

/** A number of any size. */
export function scientific(value: number): string {
  return local(value.toExponential(2));
}

/** A number that somebody set, with the digits that it was given. */
export function asSet(value: number): string {
  return local(String(value));
}

/** Numbers beside each other: commas do not part those that have commas of their own. */
export function together(numbers: string[]): string {
  return numbers.join(language.comma ? "; " : ", ");
}

/** With so many decimals; what rounds to nothing has no sign. */
export function rounded(value: unknown, digits: number): string {
  if (typeof value !== "number") return "–"; // what is no number in JSON comes as null
  if (Math.abs(value) >= 1e9) return scientific(value);
  const text = value.toFixed(digits);
  return text.startsWith("-") && Number(text) === 0 ? local(text.slice(1)) : local(text);
}

export function number(value: unknown, digits = 3): string {
  if (typeof value !== "number") return String(value);
  if (Number.isInteger(value)) return String(value);
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 1e-3)) return scientific(value);
  return rounded(value, size >= 100 ? 1 : digits);
}

/** A span in seconds, short. */
export function span(seconds: number | undefined): string {
  if (seconds === undefined) return "–";
  if (seconds < 0.95) return `${local(String(Math.round(seconds * 10) / 10))} s`;
  if (seconds < 100) return `${Math.round(seconds)} s`;
  if (seconds < 6000) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} d`;
}

export function clock(timestamp: string | undefined): string {
  if (!timestamp) return "–";
  const when = new Date(timestamp);
  if (Number.isNaN(when.getTime())) return "–"; // a robot may tell any words as a time
  const today = when.toDateString() === new Date().toDateString();
  const time = when.toLocaleTimeString(language.locale, { hourCycle: "h23" });
  return today ? time : `${when.toISOString().slice(0, 10)} ${time}`;
}

/** A moment to the tenth of a second, with its day. */
export function moment(ms: number): string {
  const when = new Date(ms);
  const day = when.toLocaleDateString(language.locale, { day: "numeric", month: "short", year: "numeric" });
  return `${day}, ${when.toLocaleTimeString(language.locale, { hourCycle: "h23" })}.${Math.floor(when.getMilliseconds() / 100)}`;
}

export function bytes(count: number | undefined): string {
  if (count === undefined) return "–";
  if (count < 1024) return `${count} B`;
  if (count < 1048576) return `${rounded(count / 1024, 1)} KiB`;
  if (count < 1073741824) return `${(count / 1048576).toFixed(0)} MiB`;
  return `${rounded(count / 1073741824, 2)} GiB`;
}

const UNSEEN = /[\p{Cc}\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069\ufeff]/gu;

/** A text with what would turn the order of letters around, or not be seen at all, written as its code. */
export function visible(text: string): string {
  return text.replaceAll(/\s*\n\s*/g, " ⏎ ").replaceAll(UNSEEN, (one) => `\\u{${one.codePointAt(0)!.toString(16)}}`);
}

/** A value on one line: enough to recognise it, never the whole of a map. */
export function brief(value: unknown, room = 80): string {
  const text = one(value, room);
  return text.length > room ? `${text.slice(0, room - 1)}…` : text;
}

function one(value: unknown, room: number): string {
  if (value === null || value === undefined) return "–";
  if (typeof value === "number") return number(value);
  if (typeof value === "boolean") return say(value ? "yes" : "no");
  if (typeof value === "string") return visible(value.slice(0, room + 1));
  if (Array.isArray(value)) {
    if (value.length > 6) return `${value.length} items`;
    return `[${together(value.map((item) => one(item, room)))}]`;
  }
  let text = "";
  for (const [key, item] of Object.entries(value as object)) {
    if (key === "timestamp" || key === "frame_id") continue;
    const told = one(item, room);
    text += `${text && "  "}${visible(key.slice(0, room))} ${typeof item === "object" && item !== null && !Array.isArray(item) ? `{${told}}` : told}`;
    if (text.length > room) break;
  }
  return text;
}

/** What of a value was given: without the members that are null. */
export function given(value: unknown): unknown {
  if (value === null || typeof value !== "object" || Array.isArray(value)) return value;
  return Object.fromEntries(Object.entries(value).filter(([, part]) => part !== null).map(([key, part]) => [key, given(part)]));
}

/** The value as text, with what is long cut: for a person to look at. */
export function pretty(value: unknown): string {
  return JSON.stringify(
    value,
    (_, item) => {
      if (typeof item === "string" && item.length > 300) return `${item.slice(0, 60)}… (${item.length} characters)`;
      if (Array.isArray(item) && item.length > 24) return [...item.slice(0, 12), `… ${item.length} items`];
      return item;
    },
    2,
  );
}

/** The whole value, nothing cut, for a person who has to know it: what cannot be seen is written as its code. */
export function exact(value: unknown): string {
  const text = JSON.stringify(value ?? null, null, 2);
  return text.replaceAll(/[\p{Cf}\p{Zl}\p{Zp}\p{Co}\p{Cn}]/gu, (one) => [...one].map((part) => `\\u{${part.codePointAt(0)!.toString(16)}}`).join(""));
}

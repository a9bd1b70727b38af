import { say, vocabulary } from "./language.svelte.ts";
import { brief } from "./format.ts";
import { errorWord } from "./words.ts";

/** How bad an entry is, the least first. */
export const LEVELS = ["info", "warning", "error"] as const;
export type Level = (typeof LEVELS)[number];
export type Source = "event" | "log" | "audit" | "notice";

/** Something that was told at a time, wherever it came from. */
export interface Entry {
  key: string;
  source: Source;
  timestamp: string;
  path: string;
  level: Level;
  text: string;
  body: any;
  /** How often it was told in the same words, where that is counted. */
  times?: number;
}

const ERRORS = new Set(["emergency", "alert", "critical", "error", "fatal", "failed"]);
const DONE = new Set(["ok", "accepted", "completed"]);
/** Of an audit record: what stands in its line, and what is for who opens it. */
const HIDDEN = new Set(["what", "principal", "outcome", "message", "request", "latches", "seq", "time", "path", "session", "roles", "proof", "id", "transport", "tenant", "status", "command", "idempotency_key", "lease"]);
vocabulary("denial", "login", "command", "lease", "approval", "start", "shutdown");

/** What is said of a robot that moves again although it is stopped. */
export function alarmText(robot: string, detail: string | undefined): string {
  return `ALARM: ${robot} is moving despite the emergency stop${detail ? `: ${detail}` : ""}`;
}

function levelOf(source: Source, path: string, body: any): Level {
  if (source === "log") return body.level === "warning" ? "warning" : "error";
  if (source === "audit") return DONE.has(body.outcome) ? "info" : "warning";
  if (source === "notice") return ["lease_lost", "overrun", "fence_left"].includes(body.code) ? "error" : "warning";
  const told = String(body?.severity ?? body?.level ?? body?.state ?? "").toLowerCase();
  if (ERRORS.has(told)) return "error";
  if (told.startsWith("warn")) return "warning";
  if (typeof body?.active === "boolean") return body.active ? "warning" : "info";
  return /failsafe|overflow/.test(path) ? "warning" : "info";
}

/** The words of an error that was written as the program has it. */
const plainly = (error: unknown): string => /^\w+\((["'])(.*)\1\)$/s.exec(String(error))?.[2] ?? String(error);

/** A list of texts that was written as the program has it, as one text. */
const listed = (text: string): string => (/^\['.*'\]$/s.test(text) ? text.slice(2, -2).replaceAll("', '", ", ") : text);

function textOf(source: Source, body: any): string {
  if (source === "log") {
    const { backend, state, detail, ...rest } = body.facts ?? {};
    if (body.message === "moves_under_estop") return alarmText(backend, detail);
    if (body.message === "halt_failed" && rest["error"] !== undefined) return `${backend} did not confirm its stop: ${plainly(rest["error"])}`;
    if (backend && state) return `${backend} is ${state}${detail ? `: ${detail}` : ""}`;
    const facts = Object.entries(backend ? { backend, ...rest } : (body.facts ?? {})).filter(([, value]) => value !== null && value !== "None");
    const written = facts.map(([key, value]) => [key, typeof value === "string" ? listed(value) : value]);
    return `${String(body.message).replaceAll("_", " ")} ${facts.length ? brief(Object.fromEntries(written), 120) : ""}`.trim();
  }
  if (source === "audit") {
    const facts = Object.entries(body).filter(([key, value]) => !HIDDEN.has(key) && value !== null);
    const outcome = DONE.has(body.outcome) ? say(body.outcome) : errorWord(body.outcome);
    const told = `${say(String(body.what).replaceAll("_", " "))} by ${body.principal}: ${outcome}`;
    const more = facts.length ? ` (${brief(Object.fromEntries(facts), 100)})` : "";
    // What went well is told by its kind.
    return `${told}${body.message && !DONE.has(body.outcome) ? `: ${brief(body.message, 200)}` : ""}${more}`;
  }
  return `${body?.active === false ? say("cleared: ") : ""}${brief(body?.message ?? body?.text ?? body, 300)}`;
}

export function entry(source: Source, path: string, timestamp: string, seq: number | string, body: any): Entry {
  const place = source === "event" || source === "notice" ? path : (body.path ?? body.logger ?? "");
  return { key: `${source} ${path} ${seq}`, source, timestamp, path: place, level: levelOf(source, path, body), text: textOf(source, body), body };
}

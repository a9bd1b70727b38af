import type { Listed } from "./inventory.svelte.ts";
import type { Robot } from "./robots.ts";
import { isOf, type Latched } from "./stops.ts";

export const LOW = 20; // % of charge that calls for attention

/** What of a robot calls for a person, the worst first. */
export type Problem = "moving" | "stopping" | "down" | "degraded" | "alarm" | "low battery" | "stopped";
const WORST: Problem[] = ["moving", "stopping", "down", "degraded", "alarm", "low battery", "stopped"];

/** A robot as a line of the fleet's table. */
export interface Entry {
  robot: Robot;
  listed: Listed | undefined;
  state: string;
  kind: string;
  mode: string;
  charge: number | undefined;
  holder: string;
  latched: Latched[];
  problems: Problem[];
}

export type Column = "problem" | "name" | "tenant" | "kind" | "state" | "mode" | "battery" | "control";

/** What is shown of a fleet, and in which order. */
export interface View {
  tenant: string;
  kind: string;
  /** A problem, `any` of them, or empty for all robots. */
  problem: string;
  sort: Column;
  descending: boolean;
  group: "" | "tenant" | "kind" | "state";
}

export const ALL: View = { tenant: "", kind: "", problem: "", sort: "problem", descending: false, group: "" };

/** A charge in percent, of what inventories and batteries tell. */
export function chargeOf(battery: any): number | undefined {
  const part = battery?.percentage ?? battery?.battery_remaining ?? battery?.remaining;
  return typeof part === "number" && Number.isFinite(part) ? Math.round(part > 1 ? part : part * 100) : undefined;
}

export function entryOf(robot: Robot, listed: Listed | undefined, health: any, all: Latched[], alarmed: ReadonlySet<string>): Entry {
  const latched = all.filter((one) => isOf(robot, one.name));
  const state = String(health?.state ?? listed?.state ?? "unknown");
  const charge = chargeOf(listed?.battery?.value);
  const mode = listed?.mode as unknown;
  const problems: Problem[] = [];
  if (latched.some((one) => one.phase === "alarm")) problems.push("moving");
  else if (latched.some((one) => one.phase !== "confirmed")) problems.push("stopping");
  else if (latched.length) problems.push("stopped");
  if (state === "down") problems.push("down");
  else if (state !== "ready") problems.push("degraded");
  if (alarmed.has(robot.name)) problems.push("alarm");
  if (charge !== undefined && charge <= LOW) problems.push("low battery");
  problems.sort((a, b) => WORST.indexOf(a) - WORST.indexOf(b));
  const text = typeof mode === "object" && mode !== null ? (mode as any).mode ?? (mode as any).state : mode;
  return { robot, listed, state, kind: (listed?.kind ?? "").replaceAll("_", " "), mode: text === undefined ? "" : String(text), charge, holder: listed?.control?.principal ?? "", latched, problems };
}

const rank = (entry: Entry): number => (entry.problems.length ? WORST.indexOf(entry.problems[0] as Problem) : WORST.length);
const KEYS: Record<Column, (entry: Entry) => string | number> = {
  problem: rank,
  name: ({ robot }) => robot.name,
  tenant: ({ robot }) => robot.tenant,
  kind: ({ kind }) => kind,
  state: ({ state }) => state,
  mode: ({ mode }) => mode,
  battery: ({ charge }) => charge ?? Infinity,
  control: ({ holder }) => holder,
};
const names = new Intl.Collator(undefined, { numeric: true });

/** The entries that a view shows, in its order; those of one group beside each other. */
export function arranged(entries: Entry[], view: View): Entry[] {
  const shown = entries.filter(
    ({ robot, kind, problems }) =>
      (!view.tenant || robot.tenant === view.tenant) &&
      (!view.kind || kind === view.kind) &&
      (!view.problem || (view.problem === "any" ? problems.length > 0 : problems.includes(view.problem as Problem))),
  );
  const key = KEYS[view.sort];
  const turn = view.descending ? -1 : 1;
  return shown.sort((a, b) => names.compare(groupOf(a, view), groupOf(b, view)) || turn * compare(key(a), key(b)) || names.compare(a.robot.name, b.robot.name));
}

function compare(a: string | number, b: string | number): number {
  return typeof a === "number" && typeof b === "number" ? (a === b ? 0 : a - b) : names.compare(String(a), String(b));
}

export function groupOf(entry: Entry, { group }: View): string {
  return group === "tenant" ? entry.robot.tenant : group === "kind" ? entry.kind || "unknown kind" : group === "state" ? entry.state : "";
}

/** The lines of a table: a heading before each group, where there are groups. */
export type Line = { heading: string; count: number } | { entry: Entry };

export function lines(entries: Entry[], view: View): Line[] {
  if (!view.group) return entries.map((entry) => ({ entry }));
  const made: Line[] = [];
  let heading: { heading: string; count: number } | undefined;
  for (const entry of entries) {
    const name = groupOf(entry, view);
    if (heading?.heading !== name) made.push((heading = { heading: name, count: 0 }));
    heading.count += 1;
    made.push({ entry });
  }
  return made;
}

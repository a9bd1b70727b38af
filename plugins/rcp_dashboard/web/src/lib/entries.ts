import type { Resource } from "rcp-client";

import type { Entry } from "./severity.ts";
import { shapes } from "./shapes.ts";

const MOST = 500;
const MANY = 20; // of one path
const SOON = 5000; // ms that so many may take before they are shown as one

/** An entry, and how many of its path it stands for. */
export interface Row extends Entry {
  count: number;
}

/** What was told, the newest first. A path that tells very often has one row, which says how often. */
export class Entries {
  rows: Row[] = [];
  /** Paths whose entries are wanted one by one however many they are. */
  readonly each = new Set<string>();
  #times = new Map<string, number[]>();
  #noisy = new Map<string, number>();
  #known = new Set<string>();

  add(fresh: Entry[]): void {
    const made: Row[] = [];
    for (const one of fresh) {
      if (this.#known.has(one.key)) continue;
      this.#known.add(one.key);
      if (one.source === "event" && this.#often(one)) this.#noisy.set(one.path, (this.#noisy.get(one.path) ?? this.#before(one.path)) + 1);
      made.push({ ...one, count: 1 });
    }
    const seen = new Set<string>();
    this.rows = [...made, ...this.rows]
      .sort((a, b) => Date.parse(b.timestamp) - Date.parse(a.timestamp))
      .filter((one) => !this.#folded(one) || (!seen.has(one.path) && seen.add(one.path)))
      .map((one) => (this.#folded(one) ? { ...one, count: this.#noisy.get(one.path) as number } : one))
      .slice(0, MOST);
    if (this.#known.size > 4 * MOST) this.#known = new Set(this.rows.map((one) => one.key));
  }

  /** Show the entries of a path one by one from now on. */
  unfold(path: string): void {
    this.each.add(path);
    this.rows = this.rows.map((one) => (one.path === path ? { ...one, count: 1 } : one));
  }

  #folded(one: Row): boolean {
    return one.source === "event" && this.#noisy.has(one.path) && !this.each.has(one.path);
  }

  #before(path: string): number {
    return this.rows.filter((one) => one.source === "event" && one.path === path).length;
  }

  #often(one: Entry): boolean {
    if (this.#noisy.has(one.path)) return true;
    const times = this.#times.get(one.path) ?? [];
    this.#times.set(one.path, times);
    times.push(Date.parse(one.timestamp));
    if (times.length > MANY) times.shift();
    return times.length === MANY && Math.abs((times.at(-1) as number) - (times[0] as number)) < SOON;
  }
}

/** What to follow for all events that operators read: tenants as a whole, or path by path where some are raw frames of a bus. */
export function eventPatterns(resources: Resource[]): string[] {
  const tenants = new Map<string, Resource[]>();
  for (const one of resources) {
    const tenant = one.path.split("/")[2] ?? "";
    if (one.kind === "event" && one.path.startsWith("/tenant/")) tenants.set(tenant, [...(tenants.get(tenant) ?? []), one]);
  }
  return [...tenants].flatMap(([tenant, events]) => {
    const readable = events.filter((one) => !shapes(one).has("frame"));
    return readable.length === events.length ? [`/tenant/${tenant}/event/**`] : readable.map((one) => one.path);
  });
}

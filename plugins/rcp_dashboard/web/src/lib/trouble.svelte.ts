import type { Notice, Update } from "rcp-client";

import { app } from "./app.svelte.ts";
import { Gathered } from "./gathered.ts";
import { alarming } from "./robots.ts";
import { entry, type Entry } from "./severity.ts";

const MOST = 50;

/** What went wrong of late: the gateway's warnings, events of robots that tell of trouble, notices to this page. */
export class Trouble {
  entries = $state.raw<Entry[]>([]);
  #log = $derived((app.status?.warnings ?? []).map((one: any, at: number) => entry("log", "", one.timestamp, `${one.timestamp} ${at}`, one)) as Entry[]);
  /** The newest first. */
  all = $derived([...this.entries, ...this.#log].sort((a, b) => Date.parse(b.timestamp) - Date.parse(a.timestamp)).slice(0, MOST));

  /** Listen until the returned function is called. */
  start(): () => void {
    const paths = app.resources.filter((one) => alarming(one) && one.operations.includes("subscribe")).map((one) => one.path);
    const told = new Gathered<Update>(10 * MOST, (all) => this.#add([...all.values()].map((update) => entry("event", update.path, update.timestamp, update.seq, update.body))));
    // One for all of them: of hundreds of robots they would be more than a session may have.
    const all = paths.length ? app.client.subscribe(paths, { history: 10, qos: { depth: 32 } }, { update: (update) => told.add(`${update.path} ${update.seq}`, update) }) : undefined;
    const stops: (() => void)[] = [() => void all?.close()];
    stops.push(() => told.stop());
    stops.push(app.client.onNotice((notice) => this.#notice(notice)));
    return () => stops.forEach((stop) => stop());
  }

  #notice(notice: Notice): void {
    if (!["stale", "deadline_missed", "lease_lost", "fence_left", "overrun", "gap"].includes(notice.code)) return;
    const path = notice.path ?? String(notice["scope"] ?? "");
    // It comes again and again while a value is overdue: what counts is when the last value came.
    const since = typeof notice["age"] === "number" ? new Date(Math.round(Date.parse(notice.timestamp) / 1000 - notice["age"]) * 1000).toISOString() : notice.timestamp;
    const message = notice.message?.replace(`${path} `, "") ?? `${notice.code.replaceAll("_", " ")} ${notice.reason ?? ""}`;
    this.#add([entry("notice", path, since, notice.code, { ...notice, message })]);
  }

  #add(all: Entry[]): void {
    this.entries = all.reduce(withOne, this.entries);
  }
}

function withOne(entries: Entry[], one: Entry): Entry[] {
  if (one.level === "info") return entries;
  const known = entries.find((other) => other.key === one.key);
  if (known && Math.abs(Date.parse(known.timestamp) - Date.parse(one.timestamp)) < 3000) return entries;
  // What is told again in the same words takes the place of the last time.
  const same = entries.find((other) => other.path === one.path && other.text === one.text && other.source === one.source);
  const newer = same && Date.parse(same.timestamp) > Date.parse(one.timestamp) ? same : one;
  const times = same ? (same.times ?? 1) + 1 : 1;
  return [{ ...newer, times }, ...entries.filter((other) => other !== known && other !== same)].slice(0, MOST);
}

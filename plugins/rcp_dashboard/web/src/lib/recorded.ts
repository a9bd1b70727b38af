import type { RcpError, Resource } from "rcp-client";

import { BASE, app } from "./app.svelte.ts";
import { ask } from "./api.ts";
import { shapes } from "./shapes.ts";

/** A sample as it was recorded. */
export interface Recorded {
  path: string;
  timestamp: string;
  received: string;
  seq: number;
  body: any;
}

export interface Page {
  samples: Recorded[];
  cursor?: string;
}

export const RECORDER = "/system/recorder";
const HEAVY = ["image", "grid", "cloud", "scan"] as const;

/** Whether it is long: few of its samples are asked for. */
export function heavy(resource: Resource | undefined): boolean {
  return resource !== undefined && HEAVY.some((shape) => shapes(resource).has(shape));
}

/** Ask for samples of several resources, in ms since the epoch; `every` in s leaves out what is more frequent. */
export async function recorded(paths: string[], from: number, to: number, more: { before?: number; every?: number; cursor?: string | undefined }): Promise<Page> {
  const query = new URLSearchParams({ from: iso(from), to: iso(to) });
  for (const path of paths) query.append("path", path);
  for (const [name, value] of Object.entries(more)) if (value !== undefined) query.set(name, String(value));
  return (await ask(`past?${query}`)) as Page;
}

/** Ask for the least and the greatest of fields in each of so many intervals, in s since the epoch; nothing where nothing was recorded. */
export async function summaries(path: string, fields: string[], from: number, to: number, count: number): Promise<Map<string, { times: number[]; values: number[] }>> {
  const every = Math.max(0.02, (to - from) / count);
  const query = new URLSearchParams({ from: iso(from * 1000), to: iso(to * 1000), every: every.toFixed(3), limit: String(2 * count) });
  if (fields.every((one) => one !== "")) query.set("fields", fields.join(","));
  const found = new Map(fields.map((one) => [one, { times: [] as number[], values: [] as number[] }]));
  const answer = await fetch(`${BASE}/rcp/v1/context${path}?${query}`, { headers: app.token ? { authorization: `Bearer ${app.token}` } : {} });
  if (!answer.ok) return found;
  const intervals = ((await answer.json()).body?.intervals ?? []) as { from: string; min: any; max: any }[];
  for (const one of intervals) {
    const start = Date.parse(one.from) / 1000;
    for (const [field, { times, values }] of found) {
      const [low, high] = field === "" ? [one.min, one.max] : [one.min[field], one.max[field]];
      if (typeof low !== "number") continue;
      times.push(start);
      values.push(low);
      if (high === low) continue;
      times.push(start + every / 2);
      values.push(high);
    }
  }
  return found;
}

const iso = (ms: number): string => new Date(ms).toISOString();

/** Why a question about the past was not answered, for people. */
export function whyNot(error: unknown): string {
  const { code, message } = error as RcpError;
  if (code === "queue_full") return "too many are looking at recordings just now";
  return message;
}

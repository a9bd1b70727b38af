import type { Update } from "rcp-client";

import { ask } from "./api.ts";
import { app } from "./app.svelte.ts";
import { pick } from "./schema.ts";
import { RECORDER, summaries } from "./recorded.ts";
import { Series } from "./series.ts";
import { past } from "./past.svelte.ts";
import { watch } from "./watch.ts";

const POINTS = 4000; // of one field, of what was before the page was opened
const AGAIN = 12_000; // ms: the gateway keeps on collecting what is asked for within 30 s
const FIELDS = 16; // of one question
const LEAST = 1; // s that recordings are asked for
const INTERVALS = 800; // of what was recorded
const LOOK = 300; // ms between looks at the moment
const LIVE = 60; // s of history that a subscription begins with

/** The fields of one path that are drawn: one subscription, whatever number of plots has them. */
class LiveFeed {
  readonly path: string;
  readonly fields = new Map<string, { series: Series; users: number }>();
  #stop: () => void;
  #timer: ReturnType<typeof setInterval>;

  constructor(path: string) {
    this.path = path;
    this.#stop = watch(path, { history: `${LIVE}s`, qos: { depth: 64 } }, (update) => this.#take(update));
    this.#timer = setInterval(() => void this.#ask([...this.fields.keys()], 0.001, 4), AGAIN);
  }

  #take(update: Update): void {
    const time = Date.parse(update.timestamp) / 1000;
    for (const [field, { series }] of this.fields) {
      const value = pick(update.body, field);
      if (value !== null) series.push(time, value);
    }
  }

  /** Get what was before, as far as the gateway has it: in its memory, and before that in recordings. */
  async fill(fields: string[], seconds: number): Promise<void> {
    for (const one of await this.#ask(fields, seconds, POINTS)) this.fields.get(one.field)?.series.prepend(one.times, one.values);
    const begin = app.client.clock.now() / 1000 - seconds;
    const missing = fields.filter((one) => (this.fields.get(one)?.series.times[0] ?? begin) > begin + Math.max(LEAST, seconds / 50));
    if (missing.length === 0 || !app.may(RECORDER, "read")) return;
    const end = Math.max(...missing.map((one) => this.fields.get(one)?.series.times[0] ?? begin));
    const found = await summaries(this.path, missing, begin, end, INTERVALS).catch(() => undefined);
    for (const [field, { times, values }] of found ?? []) this.fields.get(field)?.series.prepend(times, values);
  }

  async #ask(fields: string[], seconds: number, points: number): Promise<{ field: string; times: number[]; values: number[] }[]> {
    const query = new URLSearchParams({ path: this.path, window: String(seconds), points: String(points) });
    for (const field of fields.slice(0, FIELDS)) query.append("field", field);
    try {
      return ((await ask(`series?${query}`)) as any).series;
    } catch {
      return []; // what comes from now on is drawn all the same
    }
  }

  close(): void {
    clearInterval(this.#timer);
    this.#stop();
  }
}

/** The fields of one path around the moment in the past that is shown. */
class PastFeed {
  readonly path: string;
  readonly fields = new Map<string, { series: Series; users: number }>();
  #timer: ReturnType<typeof setInterval>;
  #seconds = 0;
  #from = 0;
  #to = 0;
  #anew = true;
  #busy = false;

  constructor(path: string) {
    this.path = path;
    this.#timer = setInterval(() => void this.#look(), LOOK);
  }

  /** Have so much of what was before the moment. */
  async fill(_: string[], seconds: number): Promise<void> {
    this.#seconds = Math.max(this.#seconds, seconds);
    this.#anew = true;
    await this.#look();
  }

  async #look(): Promise<void> {
    const at = (past.at ?? 0) / 1000;
    const span = this.#seconds;
    const newest = past.newest / 1000;
    const enough = !past.playing || at + span / 10 <= this.#to || this.#to >= newest - LEAST;
    const here = enough && at - span >= this.#from && at <= this.#to;
    if (at === 0 || this.#busy || (here && !this.#anew)) return;
    this.#busy = true;
    this.#anew = false;
    const [from, to] = [at - 1.5 * span, Math.min(at + span / 2, newest)];
    try {
      const found = await summaries(this.path, [...this.fields.keys()], from, to, INTERVALS);
      for (const [field, { times, values }] of found) {
        const series = this.fields.get(field)?.series;
        series?.clear();
        times.forEach((time, place) => series?.push(time, values[place] as number));
      }
      [this.#from, this.#to] = [from, to];
    } catch {
      this.#anew = true; // the gateway may be there again at the next look
    } finally {
      this.#busy = false;
    }
  }

  close(): void {
    clearInterval(this.#timer);
  }
}

type Feed = LiveFeed | PastFeed;
const feeds = new Map<string, Feed>();
/** Whoever logs in next begins with nothing: what the last one saw is not for all. */
const keyOf = (path: string): string => `${app.epoch} ${past.shown ? "past" : "live"} ${path}`;

/** Collect a field until the returned function is called; `seconds` of what was before come as soon as they can. */
export function collect(path: string, field: string, seconds: number): { series: Series; stop: () => void } {
  const key = keyOf(path);
  let feed = feeds.get(key);
  if (!feed) feeds.set(key, (feed = past.shown ? new PastFeed(path) : new LiveFeed(path)));
  const mine = feed;
  let kept = mine.fields.get(field);
  if (!kept) mine.fields.set(field, (kept = { series: new Series(), users: 0 }));
  kept.users += 1;
  const found = kept;
  void mine.fill([field], seconds);
  const stop = (): void => {
    found.users -= 1;
    if (found.users === 0) mine.fields.delete(field);
    if (mine.fields.size > 0) return;
    mine.close();
    if (feeds.get(key) === mine) feeds.delete(key);
  };
  return { series: found.series, stop };
}

/** Get more of what was before, where a longer span is shown now. */
export function refill(path: string, field: string, seconds: number): void {
  void feeds.get(keyOf(path))?.fill([field], seconds);
}

import type { Update } from "rcp-client";

import { ask } from "./api.ts";
import { app } from "./app.svelte.ts";
import { pick } from "./schema.ts";
import { Series } from "./series.ts";
import { watch } from "./watch.ts";

const POINTS = 4000; // of one field, of what was before the page was opened
const AGAIN = 12_000; // ms: the gateway keeps on collecting what is asked for within 30 s
const FIELDS = 16; // of one question
const LIVE = 60; // s of history that a subscription begins with

/** The fields of one path that are drawn: one subscription, whatever number of plots has them. */
class Feed {
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

  /** Get what was before, as far as the gateway has it. */
  async fill(fields: string[], seconds: number): Promise<void> {
    for (const one of await this.#ask(fields, seconds, POINTS)) this.fields.get(one.field)?.series.prepend(one.times, one.values);
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

const feeds = new Map<string, Feed>();
/** Whoever logs in next begins with nothing: what the last one saw is not for all. */
const keyOf = (path: string): string => `${app.epoch} ${path}`;

/** Collect a field until the returned function is called; `seconds` of what was before come as soon as they can. */
export function collect(path: string, field: string, seconds: number): { series: Series; stop: () => void } {
  const key = keyOf(path);
  let feed = feeds.get(key);
  if (!feed) feeds.set(key, (feed = new Feed(path)));
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

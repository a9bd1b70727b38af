/** Samples of the past in the order of time, as the page that shows them needs them: loaded ahead, told when their moment has come. */
import type { Update } from "rcp-client";

import type { Page, Recorded } from "./recorded.ts";

const AHEAD = 10_000; // ms that are loaded at once, at the usual speed
const FEW = 3000; // ms of what is long
const PATHS = 32; // of one question
const GATHER = 30; // ms in which a page asks for what it shows
const AGAIN = 3000; // ms after what failed
const EVENTS = 100; // of each path, that were told before

type Told = (update: Update) => void;
type Load = (paths: string[], from: number, to: number, more: { before?: number; every?: number; cursor?: string | undefined }) => Promise<Page>;

/** What playback needs to know of the moment, and tells of itself. */
export interface Clock {
  readonly at: number | undefined;
  /** The newest moment that is on the disk. */
  readonly newest: number;
  readonly speed: number;
  readonly playing: boolean;
  waiting: boolean;
  /** Whether all that was there when it was last asked for has been played: loading again takes longer than playing it. */
  caughtUp: boolean;
  problem: string;
  voids: number;
}

interface Listener {
  told: Told;
  /** Whether it wants each sample, and not the newest alone. */
  each: boolean;
  /** How many of a path it has been told. */
  heard: Map<string, number>;
}

interface Track {
  listeners: Set<Listener>;
  samples: { at: number; update: Update }[];
  each: boolean;
}

/** Paths that are loaded together. */
interface Batch {
  paths: string[];
  /** Up to when everything is here, ms. */
  until: number;
  to: number;
  /** Whether there was no more when it was loaded. */
  last: boolean;
  cursor: string | undefined;
  long: boolean;
  each: boolean;
  begun: boolean;
}

export class Playback {
  readonly #clock: Clock;
  readonly #load: Load;
  readonly #isLong: (path: string) => boolean;
  readonly #tracks = new Map<string, Track>();
  #batches: Batch[] = [];
  #fresh = new Set<string>();
  #timer: ReturnType<typeof setTimeout> | undefined;
  #generation = 0;
  #loading = false;
  #failed = 0;

  constructor(clock: Clock, load: Load, isLong: (path: string) => boolean) {
    this.#clock = clock;
    this.#load = load;
    this.#isLong = isLong;
  }

  /** Tell of paths until the returned function is called: of `each` sample, or of the newest at the moment. */
  follow(paths: string[], each: boolean, told: Told): () => void {
    const mine: Listener = { told, each, heard: new Map() };
    for (const path of paths) {
      let track = this.#tracks.get(path);
      if (!track || (each && !track.each)) {
        this.#tracks.set(path, (track = { listeners: track?.listeners ?? new Set(), samples: [], each: each || (track?.each ?? false) }));
        this.#drop(path);
        this.#fresh.add(path);
      }
      track.listeners.add(mine);
    }
    this.#plan();
    return () => {
      for (const path of paths) {
        const track = this.#tracks.get(path);
        track?.listeners.delete(mine);
        if (track?.listeners.size !== 0) continue;
        this.#tracks.delete(path);
        this.#drop(path);
        this.#fresh.delete(path);
      }
    };
  }

  /** Begin anew at the moment of the clock. */
  leap(): void {
    this.#generation += 1;
    this.#batches = [];
    this.#failed = 0;
    for (const [path, track] of this.#tracks) {
      track.samples = [];
      this.#fresh.add(path);
    }
    this.#clock.waiting = this.#tracks.size > 0;
    this.#plan();
  }

  /** Tell what is due, and load what will be. */
  tick(): void {
    const { at } = this.#clock;
    if (at === undefined) return;
    for (const [path, track] of this.#tracks) tell(path, track, at);
    this.#clock.waiting = this.#fresh.size > 0 || this.#batches.some((one) => this.#lacks(one, at));
    this.#clock.caughtUp = this.#batches.some((one) => one.last && one.until <= at);
    void this.#next();
  }

  /** Whether something of this moment is still to be loaded; a clock set back may leave the moment after the newest. */
  #lacks(one: Batch, at: number): boolean {
    return !one.begun || one.until < Math.min(at, this.#clock.newest);
  }

  #drop(path: string): void {
    for (const one of this.#batches) one.paths = one.paths.filter((other) => other !== path);
    this.#batches = this.#batches.filter((one) => one.paths.length > 0);
  }

  #plan(): void {
    this.#timer ??= setTimeout(() => {
      this.#timer = undefined;
      this.tick();
    }, GATHER);
  }

  /** Put what is new into batches. */
  #gather(at: number): void {
    const kinds = new Map<string, string[]>();
    for (const path of this.#fresh) {
      const kind = JSON.stringify([this.#isLong(path), this.#tracks.get(path)?.each ?? false]);
      kinds.set(kind, [...(kinds.get(kind) ?? []), path]);
    }
    this.#fresh.clear();
    for (const [kind, paths] of kinds) {
      const [long, each] = JSON.parse(kind) as [boolean, boolean];
      for (let from = 0; from < paths.length; from += PATHS)
        this.#batches.push({ paths: paths.slice(from, from + PATHS), until: at, to: at, last: false, cursor: undefined, long, each, begun: false });
    }
  }

  /** Load what is most wanted, one question after the other: each costs the gateway a process. */
  async #next(): Promise<void> {
    const { at } = this.#clock;
    if (at === undefined || this.#loading || (this.#failed && performance.now() - this.#failed < AGAIN)) return;
    if (this.#fresh.size > 0) this.#gather(at);
    const span = (one: Batch): number => (one.long ? FEW : AHEAD) * Math.max(1, this.#clock.speed);
    const due = this.#batches.filter((one) => this.#lacks(one, at) || (this.#clock.playing && one.until < Math.min(at + span(one) / 2, this.#clock.newest - GATHER))).sort((a, b) => a.until - b.until)[0];
    if (!due) return;
    const generation = this.#generation;
    this.#loading = true;
    try {
      await this.#fill(due, span(due), () => generation === this.#generation);
      this.#failed = 0;
      this.#clock.problem = "";
    } catch (error) {
      if (generation === this.#generation) this.#clock.problem = (error as Error).message;
      this.#failed = performance.now();
      this.#timer ??= setTimeout(() => ((this.#timer = undefined), void this.#next()), AGAIN);
    } finally {
      this.#loading = false;
    }
    this.tick();
  }

  async #fill(one: Batch, span: number, current: () => boolean): Promise<void> {
    const rate = (one.long ? 0.4 : 0.1) * Math.max(1, this.#clock.speed); // s between samples
    const more = { ...(!one.each && { every: rate }), ...(!one.begun && { before: one.each ? EVENTS : 1 }) };
    const { newest } = this.#clock;
    if (one.cursor === undefined) one.to = Math.max(one.until, Math.min(one.until + span, newest));
    const page = await this.#load(one.paths, one.until, one.to, { ...more, cursor: one.cursor });
    if (!current()) return;
    const first = !one.begun;
    one.begun = true;
    one.cursor = page.cursor;
    for (const sample of page.samples) this.#take(sample);
    const last = page.samples.at(-1);
    one.until = page.cursor !== undefined && last ? Date.parse(last.received) : one.to;
    one.last = one.cursor === undefined && one.to >= newest;
    if (first) this.#look(one.paths);
  }

  #take(sample: Recorded): void {
    const { path, timestamp, received, seq, body } = sample;
    const samples = this.#tracks.get(path)?.samples;
    const at = Date.parse(received);
    const last = samples?.at(-1);
    if (!samples || (last && (at < last.at || last.update.seq === seq))) return;
    samples.push({ at, update: { type: "update", id: "", path, seq, timestamp, body } });
  }

  /** Where somebody was told something that is not so at this moment, the page begins anew. */
  #look(paths: string[]): void {
    const at = this.#clock.at ?? 0;
    const gone = paths.some((path) => {
      const track = this.#tracks.get(path);
      const known = track?.samples[0] !== undefined && track.samples[0].at <= at;
      return track !== undefined && [...track.listeners].some((one) => one.heard.has(path) && (one.each || !known));
    });
    if (gone) this.#clock.voids += 1;
  }
}

/** Tell a track's listeners what they have not heard up to a moment. */
function tell(path: string, track: Track, at: number): void {
  const { samples, listeners } = track;
  const now = samples.findLastIndex((one) => one.at <= at);
  if (now < 0) return;
  const newest = samples[now]!;
  for (const one of listeners) {
    const heard = one.heard.get(path);
    if (heard === newest.update.seq) continue;
    const from = one.each ? samples.findIndex((other) => other.update.seq === heard) + 1 : now;
    for (const { update } of samples.slice(from, now + 1)) one.told(update);
    one.heard.set(path, newest.update.seq);
  }
  if (now > 0 && !track.each) samples.splice(0, now); // nobody goes back without a leap
}

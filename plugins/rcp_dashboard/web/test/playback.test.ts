import type { Update } from "rcp-client";
import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";

import { type Clock, Playback } from "../src/lib/playback.ts";
import type { Page, Recorded } from "../src/lib/recorded.ts";

const POSE = "/tenant/alpha/sensor/pose";
const FAULT = "/tenant/alpha/event/fault";
const CAMERA = "/tenant/alpha/sensor/camera";
const START = Date.UTC(2026, 10, 24, 15, 0, 0);

const sample = (path: string, second: number): Recorded => {
  const time = new Date(START + second * 1000).toISOString();
  return { path, timestamp: time, received: time, seq: second, body: second };
};

/** A recording of whole seconds from `first` to `last`, answered as the gateway does. */
class Store {
  asked: { paths: string[]; from: number; to: number; before: number }[] = [];
  fails = 0;
  most = 1000;
  constructor(readonly has: Record<string, [first: number, last: number]>) {}

  load = async (paths: string[], from: number, to: number, more: { before?: number; cursor?: string | undefined }): Promise<Page> => {
    this.asked.push({ paths, from: (from - START) / 1000, to: (to - START) / 1000, before: more.before ?? 0 });
    if (this.fails-- > 0) throw new Error("too many");
    const all = paths.flatMap((path) => {
      const [first, last] = this.has[path] ?? [1, 0];
      const seconds = Array.from({ length: last - first + 1 }, (_, at) => first + at);
      const earlier = seconds.filter((one) => START + one * 1000 < from).slice(-(more.before || 1));
      const begin = more.cursor === undefined ? from : Number(more.cursor);
      const during = seconds.filter((one) => START + one * 1000 >= begin && START + one * 1000 < to);
      return [...(more.before ? earlier : []), ...during].map((one) => sample(path, one));
    });
    all.sort((a, b) => a.seq - b.seq);
    const page = all.slice(0, this.most);
    const next = all[this.most];
    return { samples: page, ...(next && { cursor: String(Date.parse(next.received)) }) };
  };
}

describe("playback", () => {
  let clock: Clock & { at: number | undefined; speed: number; playing: boolean; newest: number };
  const told = (): { all: [string, any][]; take: (update: Update) => void } => {
    const all: [string, any][] = [];
    return { all, take: ({ path, body }) => void all.push([path.split("/").at(-1) as string, body]) };
  };
  const at = (second: number): void => void (clock.at = START + second * 1000);
  const settle = (): Promise<unknown> => vi.advanceTimersByTimeAsync(50);

  beforeEach(() => {
    vi.useFakeTimers({ toFake: ["setTimeout", "clearTimeout", "performance"] });
    clock = { at: START + 10_000, newest: START + 3_600_000, speed: 1, playing: false, waiting: false, caughtUp: false, problem: "", voids: 0 };
  });
  afterEach(() => vi.useRealTimers());

  it("tells the newest value of the moment, however old it is", async () => {
    const store = new Store({ [POSE]: [0, 3] });
    const playback = new Playback(clock, store.load, () => false);
    const { all, take } = told();
    playback.follow([POSE], false, take);
    await settle();
    expect(all).toEqual([["pose", 3]]);
    expect(clock.waiting).toBe(false);
  });

  it("asks for all that a page shows at once, and for what is long apart", async () => {
    const store = new Store({ [POSE]: [0, 20], [FAULT]: [5, 6], [CAMERA]: [0, 20] });
    const playback = new Playback(clock, store.load, (path) => path === CAMERA);
    const { all, take } = told();
    for (const path of [POSE, CAMERA, "/tenant/alpha/sensor/battery"]) playback.follow([path], false, take);
    await settle();
    expect(store.asked.map((one) => one.paths)).toEqual([[POSE, "/tenant/alpha/sensor/battery"], [CAMERA]]);
    expect(all).toEqual([["pose", 10], ["camera", 10]]);
  });

  it("moves on in order, loads ahead, and tells nothing of what is still to come", async () => {
    const store = new Store({ [POSE]: [0, 100] });
    const playback = new Playback(clock, store.load, () => false);
    const { all, take } = told();
    playback.follow([POSE], false, take);
    await settle();
    clock.playing = true;
    for (let second = 10; second <= 40; second += 0.5) {
      at(second);
      playback.tick();
      await settle();
      expect(clock.waiting).toBe(false);
    }
    expect(all.map(([, body]) => body)).toEqual(Array.from({ length: 31 }, (_, one) => 10 + one));
    expect(Math.max(...store.asked.map((one) => one.to))).toBeLessThan(60);
  });

  it("goes through pages that are too short for a span, and holds where nothing is loaded yet", async () => {
    const store = new Store({ [POSE]: [0, 100] });
    store.most = 3;
    const playback = new Playback(clock, store.load, () => false);
    const { all, take } = told();
    playback.follow([POSE], false, take);
    await settle();
    clock.playing = true;
    at(19);
    playback.tick();
    expect(clock.waiting).toBe(true);
    await settle();
    expect(clock.waiting).toBe(false);
    expect(all.at(-1)).toEqual(["pose", 19]);
  });

  it("tells each event once and in order to who wants each", async () => {
    const store = new Store({ [FAULT]: [5, 14] });
    const playback = new Playback(clock, store.load, () => false);
    const { all, take } = told();
    playback.follow([FAULT], true, take);
    await settle();
    clock.playing = true;
    for (const second of [11, 12.5, 16]) {
      at(second);
      playback.tick();
    }
    expect(all.map(([, body]) => body)).toEqual([5, 6, 7, 8, 9, 10, 11, 12, 13, 14]);
    expect(store.asked[0]?.before).toBe(100);
  });

  it("begins anew after a leap, and has the page begin anew where there was nothing yet", async () => {
    const store = new Store({ [POSE]: [8, 20] });
    const playback = new Playback(clock, store.load, () => false);
    const { all, take } = told();
    playback.follow([POSE], false, take);
    await settle();
    at(9);
    playback.leap();
    await settle();
    expect(all).toEqual([["pose", 10], ["pose", 9]]);
    expect(clock.voids).toBe(0);
    at(2);
    playback.leap();
    await settle();
    expect(all).toHaveLength(2);
    expect(clock.voids).toBe(1);
  });

  it("drops the answer of a moment that was left meanwhile", async () => {
    const store = new Store({ [POSE]: [0, 100] });
    const playback = new Playback(clock, store.load, () => false);
    const { all, take } = told();
    playback.follow([POSE], false, take);
    await vi.advanceTimersByTimeAsync(0);
    playback.tick();
    at(50);
    playback.leap();
    await settle();
    expect(all).toEqual([["pose", 50]]);
  });

  it("says what is wrong, and tries again by itself", async () => {
    const store = new Store({ [POSE]: [0, 20] });
    store.fails = 1;
    const playback = new Playback(clock, store.load, () => false);
    const { all, take } = told();
    playback.follow([POSE], false, take);
    await settle();
    expect(clock.problem).toBe("too many");
    await vi.advanceTimersByTimeAsync(4000);
    expect(clock.problem).toBe("");
    expect(all).toEqual([["pose", 10]]);
  });

  it("asks for nothing that is not on the disk yet, and for nothing any more when nobody listens", async () => {
    const store = new Store({ [POSE]: [0, 100] });
    clock.newest = START + 12_000;
    const playback = new Playback(clock, store.load, () => false);
    const stop = playback.follow([POSE], false, () => undefined);
    await settle();
    clock.playing = true;
    at(12);
    playback.tick();
    await settle();
    expect(store.asked.map((one) => one.to)).toEqual([12]);
    stop();
    playback.leap();
    await settle();
    expect(store.asked).toHaveLength(1);
    expect(clock.waiting).toBe(false);
  });

  it("shows what there is up to where it pauses by itself, however far it has come since the last answer", async () => {
    const store = new Store({ [POSE]: [0, 100] });
    clock.newest = START + 11_000;
    const playback = new Playback(clock, store.load, () => false);
    const { all, take } = told();
    playback.follow([POSE], false, take);
    await settle();
    clock.newest = START + 20_500;
    at(20.5);
    playback.tick();
    expect(clock.waiting).toBe(true);
    await settle();
    expect(all.at(-1)).toEqual(["pose", 20]);
    expect(clock.waiting).toBe(false);
  });

  it("has caught up once all is played that was there when it was asked for, however slowly it is loaded", async () => {
    const store = new Store({ [POSE]: [0, 3600] });
    const slow: Store["load"] = async (...asked) => {
      await new Promise((done) => setTimeout(done, 3000));
      return await store.load(...asked);
    };
    clock.newest = START + 40_000;
    clock.speed = 10;
    const playback = new Playback(clock, slow, () => false);
    playback.follow([POSE], false, () => undefined);
    clock.playing = true;
    for (let second = 0; second < 60 && !clock.caughtUp; second += 0.1) {
      if (!clock.waiting) clock.at = Math.min(clock.at! + 1000, clock.newest);
      playback.tick();
      await vi.advanceTimersByTimeAsync(100);
      clock.newest += 100;
    }
    expect(clock.caughtUp).toBe(true);
    expect(clock.at).toBeGreaterThanOrEqual(START + 40_000);
    expect(clock.at).toBeLessThan(clock.newest);
    playback.leap();
    await settle();
    expect(clock.caughtUp).toBe(false);
  });

  it("asks for nothing that is not there yet where the moment is after the newest", async () => {
    const store = new Store({ [POSE]: [0, 100] });
    const playback = new Playback(clock, store.load, () => false);
    playback.follow([POSE], false, () => undefined);
    await settle();
    clock.newest = START + 9000;
    at(10.5);
    playback.tick();
    await settle();
    expect(store.asked).toHaveLength(1);
    expect(clock.waiting).toBe(false);
  });
});

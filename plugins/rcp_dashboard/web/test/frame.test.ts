import { describe, expect, it } from "vitest";

import { FrameHost, type Means } from "../src/lib/layouts/frame.ts";

type Message = Record<string, any>;

function host(more: Partial<Means> = {}): { host: FrameHost; told: Message[]; watched: Map<string, { rate: number; told: (update: any) => void }> } {
  const told: Message[] = [];
  const watched = new Map<string, { rate: number; told: (update: any) => void }>();
  const made = new FrameHost({
    reads: (name) => (name === "battery" ? "/tenant/alpha/sensor/battery" : undefined),
    writes: (name) => (name === "limit" ? "/tenant/alpha/param/limit" : undefined),
    watch: (path, rate, on) => {
      watched.set(path, { rate, told: on });
      return () => watched.delete(path);
    },
    read: async (path) => ({ value: path }),
    write: async (_, value) => value,
    about: () => ({ theme: "dark" }),
    post: (message) => told.push(message),
    now: () => 0,
    ...more,
  });
  return { host: made, told, watched };
}

const settled = (): Promise<void> => new Promise((resolve) => setTimeout(resolve));

describe("a frame", () => {
  it("is told what it has when it says hello", () => {
    const { host: one, told } = host();
    one.take({ rcp: 1, type: "hello" });
    expect(told).toEqual([{ rcp: 1, type: "init", theme: "dark" }]);
  });

  it("gets values by a name, no faster than it may, until it wants no more", () => {
    const { host: one, told, watched } = host();
    one.take({ rcp: 1, type: "subscribe", name: "battery", rate: 1000 });
    const feed = watched.get("/tenant/alpha/sensor/battery")!;
    expect(feed.rate).toBe(20);
    feed.told({ body: 0.5, timestamp: "t", seq: 7 });
    expect(told).toEqual([{ rcp: 1, type: "update", name: "battery", value: 0.5, timestamp: "t", seq: 7 }]);
    one.take({ rcp: 1, type: "unsubscribe", name: "battery" });
    expect(watched.size).toBe(0);
  });

  it("leaves nothing behind when it is gone", () => {
    const { host: one, watched } = host();
    one.take({ rcp: 1, type: "subscribe", name: "battery" });
    one.close();
    expect(watched.size).toBe(0);
  });

  it("reaches nothing that it has no name for, a path least of all", async () => {
    const { host: one, told, watched } = host();
    for (const name of ["limit", "/tenant/alpha/sensor/battery", "constructor", ""]) {
      one.take({ rcp: 1, type: "subscribe", name });
      one.take({ rcp: 1, type: "read", id: name, name });
    }
    one.take({ rcp: 1, type: "write", id: "w", name: "battery", value: 1 });
    await settled();
    expect(watched.size).toBe(0);
    expect(told.every((message) => message["error"]?.code === "unknown_path")).toBe(true);
    expect(told).toHaveLength(9);
  });

  it("has its replies by the id of its request, and the reason of a refusal", async () => {
    const refusing = async (): Promise<never> => Promise.reject({ code: "forbidden", message: "no", remedy: "Press Allow writing." });
    const { host: one, told } = host({ write: refusing });
    one.take({ rcp: 1, type: "read", id: 1, name: "battery" });
    one.take({ rcp: 1, type: "write", id: 2, name: "limit", value: 3 });
    await settled();
    expect(told).toContainEqual({ rcp: 1, type: "reply", id: 1, value: "/tenant/alpha/sensor/battery" });
    expect(told).toContainEqual({ rcp: 1, type: "reply", id: 2, error: { code: "forbidden", message: "no", remedy: "Press Allow writing." } });
  });

  it("is refused more requests than it may send", async () => {
    const { host: one, told } = host();
    for (let id = 0; id < 25; id++) one.take({ rcp: 1, type: "read", id, name: "battery" });
    await settled();
    expect(told.filter((message) => message["error"]?.code === "rate_limited")).toHaveLength(5);
  });

  it("cannot use up what its operator may ask of the gateway, by no kind of message", () => {
    let asked = 0;
    const { host: one, told } = host({ watch: () => (asked++, () => {}) });
    for (let n = 0; n < 50; n++) {
      one.take({ rcp: 1, type: "subscribe", name: "battery" });
      one.take({ rcp: 1, type: "hello" });
      one.take({ rcp: 1, type: "unsubscribe", name: "battery" });
    }
    expect(asked + told.filter(({ type }) => type === "init").length).toBe(20);
    expect(told.filter((message) => message["error"]?.code === "rate_limited")).toHaveLength(50 - asked);
  });

  it("is not heard where it speaks another language", () => {
    const { host: one, told } = host();
    for (const odd of [null, "hello", 5, [], { type: "hello" }, { rcp: 2, type: "hello" }, { rcp: 1, type: "token" }]) one.take(odd);
    expect(told).toEqual([]);
  });
});

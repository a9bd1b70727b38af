import type { Resource } from "rcp-client";
import { describe, expect, it } from "vitest";

import { Entries, eventPatterns } from "../src/lib/entries.ts";
import { type Entry, entry } from "../src/lib/severity.ts";

const event = (path: string, fields: string[]): Resource =>
  ({ path, kind: "event", operations: ["subscribe"], schemas: { value: { type: "object", properties: Object.fromEntries(fields.map((one) => [one, {}])) } } }) as unknown as Resource;

describe("events that the log asks for", () => {
  it("are those of a tenant in one subscription", () => {
    expect(eventPatterns([event("/tenant/alpha/event/a", ["text"]), event("/tenant/alpha/event/b", ["text"])])).toEqual(["/tenant/alpha/event/**"]);
  });

  it("leave out raw frames of a bus, and go path by path in their tenant", () => {
    const all = [event("/tenant/alpha/event/can/main/frame", ["id", "data"]), event("/tenant/alpha/event/can/main/state", ["state"]), event("/tenant/beta/event/fault", ["fault"])];
    expect(eventPatterns(all)).toEqual(["/tenant/alpha/event/can/main/state", "/tenant/beta/event/**"]);
  });
});

describe("texts of the log", () => {
  const text = (source: "log" | "audit", body: unknown): string => entry(source, "", "", 1, body).text;

  it("of an audit record say what was done by whom, and of a refusal why", () => {
    const record = { what: "write", principal: "anna", outcome: "ok", message: "written.", id: "q-1", request: "write", transport: "ws", value: { x: 1 } };
    expect(text("audit", record)).toBe("write by anna: ok (value {x 1})");
    expect(text("audit", { ...record, what: "denial", outcome: "lease_held", message: "bert has control", value: null })).toBe("denial by anna: Someone else has control: bert has control");
  });

  it("of the gateway's log are free of the notation of its program", () => {
    expect(text("log", { message: "halt_failed", facts: { backend: "far", error: `AdapterUnavailable("it's lost")` } })).toBe("far did not confirm its stop: it's lost");
    expect(text("log", { message: "no_watchdog", facts: { vehicle: 1, missing: "['failsafe: off', 'guard: off']", robot: null } })).toBe("no watchdog vehicle 1  missing failsafe: off, guard: off");
  });
});

describe("entries of the log", () => {
  const told = (seq: number, path = "/tenant/alpha/event/fault"): Entry => ({ key: `event ${path} ${seq}`, source: "event", timestamp: new Date(1e12 + seq * 10).toISOString(), path, level: "warning", text: `fault ${seq}`, body: {} });

  it("of a path that tells very often are one row, which counts", () => {
    const entries = new Entries();
    entries.add(Array.from({ length: 50 }, (_, at) => told(at)));
    expect(entries.rows).toHaveLength(1);
    expect(entries.rows[0]?.text).toBe("fault 49");
  });

  it("are one by one again when that is asked for, and none is there twice", () => {
    const entries = new Entries();
    entries.add([told(1), told(1), told(2)]);
    expect(entries.rows.map((one) => one.text)).toEqual(["fault 2", "fault 1"]);
  });
});

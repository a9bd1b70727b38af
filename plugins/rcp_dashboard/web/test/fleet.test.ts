import { describe, expect, it } from "vitest";

import { ALL, arranged, chargeOf, type Entry, entryOf, lines } from "../src/lib/fleet.ts";
import type { Robot } from "../src/lib/robots.ts";
import type { Latched } from "../src/lib/stops.ts";

const robot = (name: string, tenant = "alpha"): Robot => ({ name, tenant, resources: [] });
const latch = (name: string, phase: Latched["phase"]): Latched => ({ name, phase, by: "ada", reason: "", since: "", requested: undefined, commanded: undefined, confirmed: undefined, detail: "", moved: false });
const entry = (name: string, more: { tenant?: string; state?: string; charge?: number; latched?: Latched[]; alarm?: boolean; kind?: string } = {}): Entry =>
  entryOf(
    robot(name, more.tenant),
    { path: "", state: "ready", ...(more.kind && { kind: more.kind }), ...(more.charge !== undefined && { battery: { value: { percentage: more.charge } } }) },
    { state: more.state ?? "ready" },
    more.latched ?? [],
    new Set(more.alarm ? [name] : []),
  );
const names = (entries: Entry[]): string[] => entries.map((one) => one.robot.name);

describe("problems", () => {
  it("puts what moves despite a stop before everything else, and what is well last", () => {
    const all = [entry("well"), entry("empty", { charge: 0.1 }), entry("rests", { latched: [latch("rests", "confirmed")] }), entry("gone", { state: "down" }), entry("moves", { latched: [latch("moves", "alarm")] }), entry("loud", { alarm: true })];
    expect(names(arranged(all, ALL))).toEqual(["moves", "gone", "loud", "empty", "rests", "well"]);
  });

  it("counts a stop that is not confirmed as stopping, whatever else rests", () => {
    const one = entry("pair", { latched: [latch("pair/left", "confirmed"), latch("pair/right", "commanded")] });
    expect(one.problems).toEqual(["stopping"]);
  });

  it("takes no robot for stopped by the latch of one whose name begins the same", () => {
    expect(entry("rover", { latched: [latch("rover-2", "confirmed")] }).problems).toEqual([]);
  });

  it("knows charges as parts and as percent, and none where there is no number", () => {
    expect([chargeOf({ percentage: 0.5 }), chargeOf({ battery_remaining: 80 }), chargeOf({ percentage: NaN }), chargeOf(undefined)]).toEqual([50, 80, undefined, undefined]);
  });
});

describe("order", () => {
  it("sorts numbers in names as people do, and robots without a battery last", () => {
    expect(names(arranged([entry("r10"), entry("r9")], { ...ALL, sort: "name" }))).toEqual(["r9", "r10"]);
    expect(names(arranged([entry("none"), entry("half", { charge: 0.5 })], { ...ALL, sort: "battery" }))).toEqual(["half", "none"]);
  });

  it("turns the order round within groups alone", () => {
    const all = [entry("a", { tenant: "t1" }), entry("b", { tenant: "t1" }), entry("c", { tenant: "t0" })];
    expect(names(arranged(all, { ...ALL, sort: "name", descending: true, group: "tenant" }))).toEqual(["c", "b", "a"]);
  });

  it("counts the robots of each group in its heading", () => {
    const view = { ...ALL, group: "kind" as const };
    const table = lines(arranged([entry("a", { kind: "arm" }), entry("b", { kind: "rover" }), entry("c", { kind: "arm" })], view), view);
    expect(table.map((one) => ("heading" in one ? `${one.heading} ${one.count}` : one.entry.robot.name))).toEqual(["arm 2", "a", "c", "rover 1", "b"]);
  });

  it("filters by tenant, kind and problem together", () => {
    const all = [entry("a", { kind: "arm", state: "down" }), entry("b", { kind: "arm" }), entry("c", { state: "down", tenant: "beta" })];
    expect(names(arranged(all, { ...ALL, tenant: "alpha", kind: "arm", problem: "any" }))).toEqual(["a"]);
  });
});

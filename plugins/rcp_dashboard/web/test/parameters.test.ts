import { type Item, RcpError, type Resource, type Schema } from "rcp-client";
import { describe, expect, it } from "vitest";

import { Editor } from "../src/lib/parameters/editor.svelte.ts";
import { agrees, assigned, isState, parameterFile, toJson } from "../src/lib/parameters/files.ts";
import { groupsOf, matches, type Parameter, parametersOf, prefixOf, rangeText } from "../src/lib/parameters/parameter.ts";
import { digits, entered, meaningOf, outside, same, weightOf } from "../src/lib/parameters/value.ts";
import { ALL, shownOf } from "../src/lib/parameters/view.ts";
import { type Change, type Device, stepsOf, Writing } from "../src/lib/parameters/writing.ts";

const resource = (name: string, value: Schema, more: Partial<Resource> = {}): Resource =>
  ({ path: `/tenant/a/param/${name}`, kind: "param", operations: ["read", "write"], description: `About ${name}`, schemas: { value }, schema_ids: {}, examples: [], backend: "r", state: "fresh", ...more }) as Resource;
const parameters = (resources: Resource[], place?: string): Parameter[] => parametersOf({ name: "r", tenant: "a", place, resources });
const only = (value: Schema, more: Partial<Resource> = {}): Parameter => parameters([resource("P", value, more)])[0] as Parameter;
const INT8 = { type: "integer", minimum: -128, maximum: 127, unit: "1" };

describe("parameters", () => {
  it("have the names, groups and order in which people look for them", () => {
    const all = parameters([resource("RC10_DZ", INT8), resource("RC2_DZ", INT8), resource("RC2_MIN", INT8), resource("RC10_MIN", INT8), resource("ALONE_HERE", INT8)]);
    expect(all.map((one) => one.name)).toEqual(["ALONE_HERE", "RC2_DZ", "RC2_MIN", "RC10_DZ", "RC10_MIN"]);
    expect(groupsOf(all)).toEqual([["RC2", 2], ["RC10", 2], ["Other", 1]]);
  });

  it("of nodes and records are grouped by these, without the robot's own place", () => {
    const all = parameters([resource("rover/wheel/gain/p", INT8), resource("rover/wheel/gain/i", INT8), resource("rover/follow.speed", INT8), resource("rover/follow.turn", INT8)], "rover");
    expect(all.map((one) => [one.name, one.group])).toEqual([["follow.speed", "follow"], ["follow.turn", "follow"], ["wheel/gain/i", "wheel/gain"], ["wheel/gain/p", "wheel/gain"]]);
  });

  it("tell range, default and meanings wherever the schema or the device has them", () => {
    const one = only({ ...INT8, range: [0, 3], values: { "2": "Land" }, bits: { "0": "Height" }, restart: true }, { meta: { parameter: "P", default: 1 } });
    expect([rangeText(one), one.default, meaningOf(one, 2), one.bits.get(0), one.restart, one.unit]).toEqual(["0 … 3", 1, "Land", "Height", true, ""]);
    expect(rangeText(only({ type: "integer", minimum: -(2 ** 31), maximum: 2 ** 31 - 1 }))).toBe("");
    expect(rangeText(only({ type: "number", minimum: 0 }))).toBe("≥ 0");
    expect(only({ type: "string", default: "x" }).default).toBe("x");
  });

  it("are found by several words of name and description", () => {
    const one = only(INT8);
    expect(matches(one, ["about", "p"])).toBe(true);
    expect(matches(one, ["about", "q"])).toBe(false);
  });
});

describe("a value", () => {
  it("of 32 bits has as few digits as tell it, one of 64 has all", () => {
    expect(digits(Math.fround(0.15))).toBe("0.15");
    expect(digits(Math.fround(16777.217))).toBe("16777.217");
    expect(digits(0.123456789012)).toBe("0.123456789012");
    expect(same(0.1, Math.fround(0.1))).toBe(true);
    expect(same([1, 2], [1, 2])).toBe(true);
    expect(same(1, 1.001)).toBe(false);
  });

  it("that is whole is another one in each of its bits, and what has parts is compared part by part", () => {
    expect(same(2 ** 25, 2 ** 25 + 1)).toBe(false);
    expect(same(0.1, 0.1000000000001)).toBe(false);
    expect(same({ a: 0.1, b: [1] }, { b: [1], a: Math.fround(0.1) })).toBe(true);
    expect(same([1], { 0: 1 })).toBe(false);
    const mask = only({ type: "integer", minimum: -(2 ** 31), maximum: 2 ** 31 - 1 });
    expect([weightOf(mask, 31), weightOf(mask, 30), weightOf(only({ type: "integer", minimum: 0, maximum: 255 }), 7)]).toEqual([-(2 ** 31), 2 ** 30, 128]);
  });

  it("is checked before it is sent, with what to enter instead", () => {
    const one = only(INT8);
    expect(entered(one, "127")).toEqual({ value: 127 });
    expect(entered(one, "128")).toEqual({ fault: "Enter a number from -128 to 127." });
    expect(entered(one, "1.5")).toEqual({ fault: "Enter a whole number." });
    expect(entered(one, "0,5")).toEqual({ fault: "Enter a number." });
    expect(entered(one, " ")).toEqual({ fault: "Enter a value." });
    expect(entered(only({ type: "number", minimum: 0 }), "-1")).toEqual({ fault: "Enter a number of at least 0." });
    expect(entered(only({ type: "number", maximum: 0 }), "1")).toEqual({ fault: "Enter a number of at most 0." });
  });

  it("of every kind is what its schema takes", () => {
    const odd = { anyOf: [{ type: "number" }, { enum: ["NaN"] }] };
    expect(entered(only(odd), "NaN")).toEqual({ value: "NaN" });
    expect(entered(only({ type: "boolean" }), "true")).toEqual({ value: true });
    expect(entered(only({ enum: ["slow", "fast"] }), '"fast"')).toEqual({ value: "fast" });
    expect(entered(only({ enum: ["slow"] }), '"fast"').fault).toBeDefined();
    const list = only({ type: "array", items: { type: "number" } });
    expect(entered(list, "[1, 2]")).toEqual({ value: [1, 2] });
    expect(entered(list, "[1, ")).toEqual({ fault: "Enter a value in JSON." });
    expect(entered(list, '["a"]').fault).toBeDefined();
    expect(entered(only({ type: "string", maxLength: 2 }), "abc").fault).toBeDefined();
  });

  it("outside what is recommended is no fault", () => {
    const one = only({ ...INT8, range: [0, 3] });
    expect([outside(one, 4), outside(one, 3), entered(one, "4").fault]).toEqual([true, false, undefined]);
  });
});

describe("a file", () => {
  const all = parameters([resource("RTL_ALT", INT8), resource("STAT_RUN", INT8), resource("node/GAIN", INT8, { meta: { parameter: "GAIN" } })]);

  it("of Mission Planner, of QGroundControl and in JSON is read", () => {
    for (const text of ["# made\nRTL_ALT,15\nSTAT_RUN 2\n", "# Vehicle-Id\n1\t1\tRTL_ALT\t15\t2\n1\t1\tSTAT_RUN\t2\t2\r\n", '{"parameters": {"RTL_ALT": 15, "STAT_RUN": 2}}', '\uFEFF{"RTL_ALT": 15, "STAT_RUN": 2}'])
      expect([...parameterFile("f", text).values]).toEqual([["RTL_ALT", 15], ["STAT_RUN", 2]]);
  });

  it("tells its faulty lines", () => {
    const { values, faults } = parameterFile("f", "RTL_ALT,high\nA,1\nA,2\nB 1 2\n");
    expect([[...values], faults.length]).toEqual([[["A", 1]], 3]);
    expect(parameterFile("f", "{ no").faults).toHaveLength(1);
    expect(parameterFile("f", "\n").faults).toEqual(["The file has no parameters."]);
  });

  it("is assigned by names here and on the device, and what is unknown is told", () => {
    const { values, unknown } = assigned(parameterFile("f", "GAIN 3\nRTL_ALT 15\nOTHER 1\n"), all);
    expect([...values]).toEqual([["/tenant/a/param/node/GAIN", 3], ["/tenant/a/param/RTL_ALT", 15]]);
    expect(unknown).toEqual(["OTHER"]);
    const twins = parameters([resource("one/GAIN", INT8, { meta: { parameter: "GAIN" } }), resource("two/GAIN", INT8, { meta: { parameter: "GAIN" } })]);
    expect(assigned(parameterFile("f", "GAIN 3"), twins).unknown).toEqual(["GAIN"]);
  });

  it("that has rounded a value is not different from it for that, and one with few digits is", () => {
    const kept = Math.fround(0.0123456789);
    const says = (text: string, now: number): boolean => {
      const { values, decimals } = parameterFile("f", `A ${text}\n`);
      return agrees(now, values.get("A"), decimals.get("A"));
    };
    expect([says("0.012346", kept), says("0.01234568", kept), says("16777.22", Math.fround(16777.217)), says("0.000000", 1e-7)]).toEqual([true, true, true, true]);
    expect([says("0.012345", kept), says("0.012", kept), says("0.1", Math.fround(0.12)), says("3", 3.4), says("0.000000", 1e-6)]).toEqual([false, false, false, false, false]);
  });

  it("that was saved is read as it was", () => {
    const text = toJson("r", [["RTL_ALT", 15], ["mode", "fast"]], "2026-01-01");
    expect([...parameterFile("f", text).values]).toEqual([["RTL_ALT", 15], ["mode", "fast"]]);
  });

  it("does not bring back what the device itself keeps", () => {
    expect(all.map((one) => [one.name, isState(one)])).toEqual([["node/GAIN", false], ["RTL_ALT", false], ["STAT_RUN", true]]);
  });
});

/** A device that keeps what is written, and refuses or loses what it is told to. */
class Fake implements Device {
  has: Record<string, unknown> = { a: 0, b: 0, c: 0 };
  refuses: Record<string, RcpError> = {};
  /** Keeps the value, and its answer is lost. */
  loses = "";
  cut = false;
  sent: unknown[] = [];
  approval: string | undefined;

  async write(path: string, value: unknown, approval: string | undefined): Promise<unknown> {
    this.sent.push(path);
    if (this.refuses[path] && approval === undefined) throw this.refuses[path];
    this.approval = approval;
    this.has[path] = value;
    if (path === this.loses) {
      this.cut = true;
      throw new RcpError({ code: "connection_lost", message: "cut" });
    }
    return value;
  }
  async writeAll(values: Record<string, unknown>): Promise<Record<string, unknown>> {
    this.sent.push(values);
    const refused = Object.keys(values).find((path) => this.refuses[path]);
    if (refused) throw new RcpError({ code: "device_rejected", message: "no", details: { faults: [{ path: refused, code: "device_rejected", message: "too hot" }] } });
    Object.assign(this.has, values);
    return { ...values };
  }
  async read(path: string): Promise<unknown> {
    if (this.cut) throw new RcpError({ code: "connection_lost", message: "not connected" });
    return this.has[path];
  }
}

const change = (path: string, value: unknown, atomic?: string): Change => ({ path, name: path, before: 0, value, atomic });
const ABC = [change("a", 1), change("b", 2), change("c", 3)];
const outcomes = (writing: Writing): string[] => writing.results.map((one) => one.outcome);
const refusal = (code: string, details = {}): RcpError => new RcpError({ code, message: code, details });

describe("writing", () => {
  it("writes those of one group as one, as many as the gateway takes, and the others by themselves", () => {
    const steps = stepsOf([change("a", 1, "g"), change("b", 2), change("c", 3, "g"), change("d", 4, "h")]);
    expect(steps.map((one) => [one.changes.map(({ path }) => path).join(), one.asOne])).toEqual([["a,c", true], ["b", false], ["d", false]]);
    expect(stepsOf(Array.from({ length: 100 }, (_, at) => change(`p${at}`, at, "g"))).map((one) => one.changes.length)).toEqual([64, 36]);
    expect(stepsOf([change("a", "x".repeat(14_000), "g"), change("b", "x".repeat(14_000), "g")])).toHaveLength(2);
  });

  it("writes one after the other, and reads back what the device has", async () => {
    const device = new Fake();
    const writing = new Writing(ABC, device, () => undefined);
    await writing.run();
    expect([outcomes(writing), device.sent, writing.error]).toEqual([["written", "written", "written"], ["a", "b", "c"], undefined]);
    expect(writing.results.every((one) => one.read)).toBe(true);
  });

  it("stops at the first refusal, and tells what was written and what was not", async () => {
    const device = new Fake();
    device.refuses = { b: refusal("lease_held") };
    const writing = new Writing(ABC, device, () => undefined);
    await writing.run();
    expect([outcomes(writing), device.sent, writing.error?.code]).toEqual([["written", "refused", "unsent"], ["a", "b"], "lease_held"]);
    expect(writing.results[1]).toMatchObject({ now: 0, read: true });
  });

  it("tells where the device has another value than was written", async () => {
    const device = new Fake();
    device.read = async (path) => (path === "b" ? 1.5 : device.has[path]);
    const writing = new Writing(ABC, device, () => undefined);
    await writing.run();
    expect([outcomes(writing), writing.results[1]?.now]).toEqual([["written", "other", "written"], 1.5]);
  });

  it("as one tells which was refused, and that nothing was written", async () => {
    const device = new Fake();
    device.refuses = { b: refusal("device_rejected") };
    const writing = new Writing(ABC.map((one) => ({ ...one, atomic: "g" })), device, () => undefined);
    await writing.run();
    expect([outcomes(writing), device.has["a"], writing.asOne]).toEqual([["refused", "refused", "refused"], 0, true]);
    expect(writing.results.map((one) => one.error?.message)).toEqual([undefined, "too hot", undefined]);
  });

  it("does not say what became of a lost answer before the device was asked again", async () => {
    const device = new Fake();
    device.loses = "b";
    const writing = new Writing(ABC, device, () => undefined);
    await writing.run();
    expect([outcomes(writing), writing.unread]).toEqual([["written", "unknown", "unsent"], true]);
    device.cut = false;
    await writing.readBack();
    expect([outcomes(writing), writing.unread]).toEqual([["written", "written", "unsent"], false]);
  });

  it("knows by asking that a lost write did not arrive, and that what was never sent was not", async () => {
    const device = new Fake();
    device.refuses = { b: refusal("deadline_exceeded") };
    const late = new Writing(ABC, device, () => undefined);
    await late.run();
    expect(outcomes(late)).toEqual(["written", "kept", "unsent"]);
    device.refuses = { b: new RcpError({ code: "connection_lost", message: "not connected", retryable: true }) };
    const away = new Writing(ABC, device, () => undefined);
    await away.run();
    expect(outcomes(away)).toEqual(["written", "unsent", "unsent"]);
  });

  it("waits for a person's approval, and goes on with it from there", async () => {
    const device = new Fake();
    device.refuses = { b: refusal("approval_required", { approval: "7" }) };
    const writing = new Writing(ABC, device, () => undefined);
    await writing.run();
    expect([outcomes(writing), writing.waiting?.changes[0]?.path]).toEqual([["written", "unsent", "unsent"], "b"]);
    await writing.run("7");
    expect([outcomes(writing), device.sent, writing.waiting]).toEqual([["written", "written", "written"], ["a", "b", "b", "c"], undefined]);
  });

  it("does not say that it wrote what the device has of somebody else after a lost answer", async () => {
    const device = new Fake();
    device.refuses = { b: refusal("adapter_unavailable") };
    device.read = async (path) => (path === "b" ? 44 : device.has[path]);
    const writing = new Writing(ABC, device, () => undefined);
    await writing.run();
    expect([outcomes(writing), writing.results[1]?.now]).toEqual([["written", "changed", "unsent"], 44]);
  });

  it("is stopped after what is under way", async () => {
    const writing: Writing = new Writing(ABC, new Fake(), () => writing.stop());
    await writing.run();
    expect([outcomes(writing), writing.stopped]).toEqual([["written", "unsent", "unsent"], true]);
  });
});

describe("an editor", () => {
  const all = parameters([resource("a", INT8, { meta: { default: 0 } }), resource("b", INT8), resource("c", INT8, { operations: ["read"] })]);
  const [a, b, c] = all as [Parameter, Parameter, Parameter];

  async function opened(): Promise<[Editor, Fake]> {
    const device = new Fake();
    device.has = Object.fromEntries(all.map((one) => [one.path, 0]));
    async function* pages(): AsyncGenerator<Item[]> {
      yield all.map(({ path }) => ({ path, status: "completed" as const, body: device.has[path] }));
    }
    const execute = async (): Promise<unknown> => ({ values: { b: 4 } });
    const editor = new Editor({ device, pages, execute, look: (path) => device.read(path) });
    await editor.read("**", new Set(all.map((one) => one.path)));
    return [editor, device];
  }

  it("keeps what was entered until it is written, and nothing that is so already", async () => {
    const [editor, device] = await opened();
    editor.enter(a, "5");
    editor.enter(b, "500");
    expect([editor.pending.size, editor.faulty]).toEqual([2, 1]);
    await editor.write(all);
    expect(device.sent).toEqual([]);
    editor.enter(b, "0");
    await editor.write(all);
    expect([device.sent, editor.pending.size, editor.valueOf(a.path)]).toEqual([[a.path], 0, 5]);
  });

  it("has the values of before pending again, to take back what was written", async () => {
    const [editor] = await opened();
    editor.enter(a, "5");
    await editor.write(all);
    editor.revert(all);
    expect(editor.pending.get(a.path)).toEqual({ text: "0", value: 0, from: 5 });
  });

  it("keeps what was refused and what was entered while it was written", async () => {
    const [editor, device] = await opened();
    editor.enter(a, "5");
    editor.enter(b, "6");
    device.refuses = { [b.path]: refusal("estop_active") };
    const done = editor.write(all);
    editor.enter(a, "7");
    await done;
    expect([...editor.pending.keys()]).toEqual([a.path, b.path]);
  });

  it("keeps what is being typed, also where the robot has just that", async () => {
    const [editor, device] = await opened();
    editor.take([[a.path, { value: 5 }]]);
    device.has[a.path] = 5;
    editor.type(a, "5.");
    expect(editor.pending.get(a.path)).toMatchObject({ text: "5.", value: 5 });
    editor.settle([a.path]);
    expect(editor.pending.size).toBe(0);
    editor.type(a, "5");
    await editor.write(all);
    expect([device.sent, editor.pending.size]).toEqual([[], 0]);
  });

  it("sends nothing with an approval that has been discarded or changed meanwhile", async () => {
    const [editor, device] = await opened();
    editor.enter(a, "5");
    editor.enter(b, "6");
    device.refuses = { [a.path]: refusal("approval_required", { approval: "7" }) };
    await editor.write(all);
    expect(editor.writing?.waiting).toBeDefined();
    editor.undo(b.path);
    expect(editor.writing?.waiting).toBeUndefined();
    await editor.goOn("7");
    expect([device.sent, [...editor.pending.keys()]]).toEqual([[a.path], [a.path]]);
  });

  it("does not show a value that was written where the robot has told another one since", async () => {
    const [editor, device] = await opened();
    device.refuses = { [b.path]: refusal("approval_required", { approval: "7" }) };
    editor.enter(a, "5");
    editor.enter(b, "6");
    await editor.write(all);
    editor.take([[a.path, { value: 9 }]]);
    editor.enter(a, "5");
    await editor.goOn("7");
    expect([editor.valueOf(a.path), editor.pending.get(a.path)?.text, editor.valueOf(b.path)]).toEqual([9, "5", 6]);
  });

  it("tells what somebody has changed since the change was entered", async () => {
    const [editor, device] = await opened();
    editor.enter(a, "5");
    editor.enter(b, "6");
    device.has[a.path] = 9;
    expect((await editor.overtaken(all)).map((one) => one.name)).toEqual(["a"]);
    expect(editor.valueOf(a.path)).toBe(9);
    device.has[a.path] = 5;
    expect(await editor.overtaken(all)).toEqual([]);
    await editor.write(all);
    expect(device.sent).toEqual([b.path]);
  });

  it("keeps what was written while all are read", async () => {
    const device = new Fake();
    async function* pages(): AsyncGenerator<Item[]> {
      slow.take([[a.path, { value: 5 }]]); // as after a write
      yield all.map(({ path }) => ({ path, status: "completed" as const, body: 0 }));
    }
    const slow = new Editor({ device, pages, execute: async () => ({}), look: (path) => device.read(path) });
    await slow.read("**", new Set(all.map((one) => one.path)));
    expect([slow.valueOf(a.path), slow.valueOf(b.path)]).toEqual([5, 0]);
  });

  it("forgets what a gateway told that is gone, and not what was entered", async () => {
    const [editor] = await opened();
    editor.enter(a, "5");
    editor.forget();
    expect([editor.valueOf(a.path), editor.pending.size]).toEqual([undefined, 1]);
  });

  it("takes nothing from a file for what may not be written", async () => {
    const [editor] = await opened();
    editor.enterAll([[a, 4], [c, 4]]);
    expect([...editor.pending.keys()]).toEqual([a.path]);
    editor.undo(a.path);
    expect(editor.pending.size).toBe(0);
  });

  it("asks the robot for defaults that the schema does not have", async () => {
    const [editor] = await opened();
    await editor.readDefaults([["service", ""], ["other", "node/"]]);
    expect(editor.defaults?.get("node/b")).toBe(4);
    const told = parametersOf({ name: "r", tenant: "a", resources: all.map((one) => one.resource) }, editor.defaults);
    expect(shownOf(told, { ...ALL, show: "changed" }, editor, undefined).map((one) => [one.name, one.default])).toEqual([["b", 4]]);
    expect(prefixOf({ path: "/tenant/a/service/rover/node/param/defaults" } as Resource, "rover")).toBe("node/");
  });

  it("shows what was changed, is pending or is different in a file", async () => {
    const [editor] = await opened();
    const names = (show: "changed" | "pending" | "file", values = new Map<string, unknown>()): string[] => shownOf(all, { ...ALL, show }, editor, { values, decimals: new Map() }).map((one) => one.name);
    editor.enter(b, "3");
    editor.take([[a.path, { value: 9 }]]);
    expect([names("changed"), names("pending"), names("file", new Map([[a.path, 9], [c.path, 1]]))]).toEqual([["a"], ["b"], ["c"]]);
    expect(shownOf(all, { ...ALL, text: "about C" }, editor, undefined)).toEqual([c]);
  });
});

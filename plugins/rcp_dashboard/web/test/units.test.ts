import { afterEach, describe, expect, it } from "vitest";

import type { Resource } from "rcp-client";

import { converted } from "../src/lib/converted.ts";
import { bytes, clock, number, rounded, span, together } from "../src/lib/format.ts";
import { digitsOf, type Joint, stepsOf, typedTarget } from "../src/lib/joints.ts";
import { language } from "../src/lib/language.svelte.ts";
import { rule } from "../src/lib/map/plane.ts";
import { fixed, rangeAt } from "../src/lib/plots.svelte.ts";
import { distance, height, measured, measuredAll, units } from "../src/lib/units.svelte.ts";

afterEach(async () => {
  units.choose("metric");
  await language.choose("en");
});

describe("units", () => {
  it("are metric unless others are chosen", () => {
    expect(measured(1.5, "m/s", 2)).toBe("1.50 m/s");
    expect([units.shown(21, "Cel"), units.meant(21, "Cel")]).toEqual([21, 21]);
    expect([height(30), height(2.54), distance(999), distance(1500)]).toEqual(["30 m", "2.5 m", "999 m", "1.50 km"]);
  });

  it("are imperial where they are chosen, and stand beside the number", () => {
    units.choose("imperial");
    expect([measured(30.48, "m", 0), measured(10, "m/s", 1), measured(1, "kg", 2), measured(21, "Cel", 1)]).toEqual(["100 ft", "22.4 mph", "2.20 lb", "69.8 °F"]);
    expect(measuredAll([1, -2], "m", 2)).toBe("3.28, -6.56 ft");
    expect([distance(100), distance(1609.344)]).toEqual(["328 ft", "1.00 mi"]);
    expect(measured(0.5, "rad/s", 2)).toBe("0.50 rad/s");
  });

  it.each(["m", "km", "m/s", "kg", "Cel", "mm", "m/s2"])("of %s lead back to what they were made of", (unit) => {
    units.choose("imperial");
    for (const value of [-40, 0, 0.123, 30, 12_345.678]) expect(units.meant(units.shown(value, unit), unit)).toBeCloseTo(value, 6);
  });

  it("are metric in what is sent", () => {
    units.choose("imperial");
    expect([units.meant(100, "m"), units.meant(32, "Cel"), units.box(9, "m")]).toEqual([30.48, 0, 29.53]);
    expect(units.meant(Number.NaN, "m")).toBeNaN();
  });

  it("of a rate of change have no zero of their own", () => {
    units.choose("imperial");
    expect([units.name("Cel/s"), units.shown(1, "Cel/s"), units.meant(1.8, "Cel/s")]).toEqual(["°F/s", 1.8, 1]);
    expect([units.name("rad/s"), units.name("1/s"), units.name("kg/s")]).toEqual(["rad/s", "1/s", "lb/s"]);
  });

  it("are those of each number of a value, and of nothing else in it", () => {
    const schema = { properties: { at: { properties: { x: { type: "number", unit: "m" }, yaw: { type: "number", unit: "rad" } } }, heat: { type: "array", items: { type: "number", unit: "Cel" } } } };
    const resource = { schemas: { value: schema } } as unknown as Resource;
    const value = { at: { x: 3.048, yaw: 1 }, heat: [0, 100], name: "m", none: null, many: Array.from({ length: 40 }, () => 1) };
    expect(converted(resource, value)).toBe(value);
    units.choose("imperial");
    const shown = converted(resource, value) as typeof value;
    expect(shown.at.x).toBeCloseTo(10, 9);
    expect(shown).toMatchObject({ at: { yaw: 1 }, heat: [32, 212], name: "m", none: null });
    expect(shown.many).toBe(value.many);
  });

  it("of the first axis of a plot are those in which its range is typed, and the other axis keeps its own", () => {
    units.choose("imperial");
    const plot = fixed(["/a#height", "/a#voltage"], units.meant(0, "m"), units.meant(100, "m"));
    expect([rangeAt(plot, 0, "m"), rangeAt(plot, 1, "V")]).toEqual([[0, 100], undefined]);
    units.choose("metric");
    expect([rangeAt(plot, 0, "m"), rangeAt(plot, 1, "V")]).toEqual([[0, 30.48], undefined]);
    expect(rangeAt(["/a#height"], 0, "m")).toBeUndefined();
  });

  it("have a ruler of their own on the map", () => {
    expect(rule(55)).toEqual({ step: 50, words: "50 m" });
    units.choose("imperial");
    expect(rule(55).words).toBe("100 ft");
    expect(rule(55).step).toBeCloseTo(30.48, 6);
    expect(rule(5000).words).toBe("2 mi");
  });
});

describe("joints", () => {
  const lift: Joint = { field: "", name: "lift", least: 0, most: 0.3, unit: "m" };
  const pan: Joint = { field: "", name: "pan", least: -2.8, most: 2.8, unit: "rad" };

  it("are sent what was typed, as the actuator takes it", () => {
    expect([typedTarget("0.3", lift), typedTarget("0.31", lift), typedTarget("", lift), typedTarget("up", lift)]).toEqual([0.3, undefined, undefined, undefined]);
    units.choose("imperial");
    expect([typedTarget("0.5", lift), typedTarget("1", lift), typedTarget("-0.01", lift)]).toEqual([0.1524, undefined, undefined]);
    expect(typedTarget("-1.5", pan)).toBe(-1.5);
  });

  it("go to a bound that is typed as it is shown, and no further", () => {
    units.choose("imperial");
    const text = rounded(units.shown(0.3, "m"), digitsOf(lift)); // 0.984, and 0.98425 is meant
    expect(typedTarget(text, lift)).toBeCloseTo(0.3, 3);
    const drive: Joint = { field: "", name: "slide", least: -0.5, most: 0.5, unit: "m/s" };
    expect(typedTarget("1.12", drive)).toBe(0.5); // 1.1185 mph
    expect(typedTarget("1.13", drive)).toBeUndefined();
  });

  it("have round steps, and decimals, for the unit that is shown", () => {
    expect([stepsOf([lift]), digitsOf(lift), digitsOf(pan)]).toEqual([[0.0005, 0.005, 0.05], 3, 2]);
    units.choose("imperial");
    expect(stepsOf([lift])).toEqual([0.002, 0.02, 0.1]);
    expect(stepsOf([pan])).toEqual([0.01, 0.1, 0.5]);
  });
});

describe("numbers and dates", () => {
  it("are written as the language writes them", async () => {
    await language.choose("de");
    expect([rounded(1.234, 2), number(0.0005), span(0.5), bytes(1536)]).toEqual(["1,23", "5,00e-4", "0,5 s", "1,5 KiB"]);
    expect(together([rounded(1.5, 1), rounded(2.5, 1)])).toBe("1,5; 2,5");
    expect(clock(new Date().toISOString())).toMatch(/^\d\d:\d\d:\d\d$/);
  });
});

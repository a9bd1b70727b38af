import { afterEach, describe, expect, it } from "vitest";

import { bytes, clock, number, rounded, span, together } from "../src/lib/format.ts";
import { language } from "../src/lib/language.svelte.ts";
import { rule } from "../src/lib/map/plane.ts";
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

  it("have a ruler of their own on the map", () => {
    expect(rule(55)).toEqual({ step: 50, words: "50 m" });
    units.choose("imperial");
    expect(rule(55).words).toBe("100 ft");
    expect(rule(55).step).toBeCloseTo(30.48, 6);
    expect(rule(5000).words).toBe("2 mi");
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

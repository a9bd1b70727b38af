import { afterEach, describe, expect, it } from "vitest";

import { language } from "../src/lib/language.svelte.ts";
import type { Parameter } from "../src/lib/parameters/parameter.ts";
import { entered } from "../src/lib/parameters/value.ts";
import { boxed, numberTyped, pointed } from "../src/lib/typed.ts";
import { units } from "../src/lib/units.svelte.ts";

afterEach(async () => {
  units.choose("metric");
  await language.choose("en");
});

describe("numbers that are typed", () => {
  it("have a point in English, and a comma is refused", () => {
    expect(["1.5", " -0.25 ", ".5", "2.", "1e3", "−3", "1.500"].map(numberTyped)).toEqual([1.5, -0.25, 0.5, 2, 1000, -3, 1.5]);
    expect(["1,5", "1,500", "1.500,5", "", " ", "x", "0x10", "1e999", "Infinity", "1 5", "1.2.3"].map(numberTyped)).toEqual(Array(11).fill(NaN));
    expect([boxed(1.5), boxed(NaN)]).toEqual(["1.5", ""]);
  });

  it("have a comma in German, or a point that cannot be of thousands", async () => {
    await language.choose("de");
    expect(["1,5", "-0,125", ",5", "1.5", "0.125", "47.3769", "1500"].map(numberTyped)).toEqual([1.5, -0.125, 0.5, 1.5, 0.125, 47.3769, 1500]);
    expect(["1.500", "-12.345", "1.500,5", "1,5,5", "1,", ""].map(numberTyped)).toEqual([NaN, NaN, NaN, NaN, 1, NaN]);
    expect([boxed(1.5), pointed("1,5"), pointed("1.500")]).toEqual(["1,5", "1.5", "1.500"]);
  });

  it.each(["en", "de"])("lead back to themselves in %s, with either units", async (code) => {
    await language.choose(code);
    for (const system of ["metric", "imperial"] as const) {
      units.choose(system);
      for (const value of [0, 2, 30, 0.5, 98.43, -12.25, 1234.5]) {
        const sent = units.meant(numberTyped(boxed(value)), "m");
        expect(boxed(units.box(sent, "m"))).toBe(boxed(value));
      }
    }
  });

  it("are the same for parameters", async () => {
    const one = { entry: "number", low: 0, high: 5, schema: { type: "number" } } as unknown as Parameter;
    expect(entered(one, "1,5")).toEqual({ fault: "Enter a number." });
    await language.choose("de");
    expect(entered(one, "1,5")).toEqual({ value: 1.5 });
  });
});

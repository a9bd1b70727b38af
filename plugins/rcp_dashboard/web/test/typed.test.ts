import { render } from "svelte/server";
import { afterEach, describe, expect, it } from "vitest";

import { language } from "../src/lib/language.svelte.ts";
import { type Parameter, rangeText } from "../src/lib/parameters/parameter.ts";
import { boxText, entered, textOf } from "../src/lib/parameters/value.ts";
import { faults, numberEntered } from "../src/lib/schema.ts";
import { boxed, numberTyped, pointed } from "../src/lib/typed.ts";
import { units } from "../src/lib/units.svelte.ts";
import HeightMenu from "../src/parts/HeightMenu.svelte";

const GAIN = { entry: "number", low: undefined, high: 5000, schema: { type: "number" } } as unknown as Parameter;

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

  it("are the same for forms, with the digits of long ones", async () => {
    const sent = (text: string): unknown => (faults(numberEntered(text), { type: "number" }).length ? "refused" : numberEntered(text));
    expect(["1.500", "0x10", "1,5", " +2 ", "−3", "1e3"].map(sent)).toEqual([1.5, "refused", "refused", 2, -3, 1000]);
    expect(["9007199254740993", "+9007199254740993", "NaN", " "].map(numberEntered)).toEqual(["9007199254740993", "9007199254740993", "NaN", ""]);
    await language.choose("de");
    expect(["1.500", "0x10", "1,5", "1.5", "1500"].map(sent)).toEqual(["refused", "refused", 1.5, 1.5, 1500]);
    expect(numberEntered("1.500")).toBe("1.500"); // it stays in the box, as it was typed
  });

  it("are the same for parameters", async () => {
    const fault = "Enter a number.";
    expect(["1,5", "0x10", "1.500"].map((text) => entered(GAIN, text))).toEqual([{ fault }, { fault }, { value: 1.5 }]);
    await language.choose("de");
    expect(["1,5", "0x10", "1.500"].map((text) => entered(GAIN, text))).toEqual([{ value: 1.5 }, { fault }, { fault }]);
  });

  it.each(["en", "de"])("stand in the boxes of parameters so that they are read again in %s", async (code) => {
    await language.choose(code);
    for (const value of [1.125, -12.345, Math.fround(0.15), 1e-7, 1e-5, 1500]) {
      const found = entered(GAIN, boxText(GAIN, value)) as { value: number };
      expect(Math.fround(found.value)).toBe(Math.fround(value));
    }
    const list = { entry: "json", schema: {} } as unknown as Parameter;
    expect([boxText(list, 1.125), boxText(list, [0.5]), entered(list, boxText(list, 1.125))]).toEqual(["1.125", "[0.5]", { value: 1.125 }]);
  });

  it("are written as the language does beside the boxes, too", async () => {
    const height = (): string => render(HeightMenu, { props: { height: [1.5, 2.5], unit: "m", onheight: () => {} } }).body;
    expect([textOf(1.125), rangeText({ ...GAIN, low: 0.5 }), height()]).toEqual(["1.125", "0.5 … 5000", expect.stringContaining("↕ 1.5 … 2.5<")]);
    await language.choose("de");
    expect([textOf(1.125), rangeText({ ...GAIN, low: 0.5 }), height()]).toEqual(["1,125", "0,5 … 5000", expect.stringContaining("↕ 1,5 … 2,5<")]);
  });
});

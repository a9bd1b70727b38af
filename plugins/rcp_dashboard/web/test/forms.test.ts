import { describe, expect, it } from "vitest";

import { stepsOf } from "../src/lib/joints.ts";
import { language } from "../src/lib/language.svelte.ts";
import { blank, faults, missing, numberOf, spells } from "../src/lib/schema.ts";

const GOAL = {
  type: "object",
  required: ["position", "mode"],
  properties: {
    position: { $ref: "#/$defs/Point" },
    mode: { enum: ["slow", "fast"] },
    speed: { type: "number" },
    tolerance: { type: "number", default: 0.1 },
  },
  $defs: { Point: { type: "object", required: ["x", "y"], properties: { x: { type: "number" }, y: { type: "number" } } } },
};

describe("a form that begins", () => {
  it("has no number that nobody entered", () => {
    expect(blank(GOAL, GOAL)).toEqual({ position: {} });
  });

  it("keeps what the schema sets by default where it is required", () => {
    const schema = { ...GOAL, required: [...GOAL.required, "tolerance"] };
    expect(blank(schema, schema)).toEqual({ position: {}, tolerance: 0.1 });
  });

  it("is null where null is a value", () => {
    const schema = { anyOf: [{ type: "null" }, { type: "number" }] };
    expect(blank(schema, schema)).toBeNull();
    expect(missing(null, schema, schema)).toEqual([]);
  });
});

describe("what is missing", () => {
  it("is told at the field, however deep", () => {
    expect(missing({ position: { x: 1 } }, GOAL, GOAL).map((one) => one.pointer)).toEqual(["/position/y", "/mode"]);
  });

  it("is an emptied number too, and no zero", () => {
    expect(missing({ position: { x: "", y: 0 }, mode: "slow" }, GOAL, GOAL).map((one) => one.pointer)).toEqual(["/position/x"]);
  });

  it("is asked for within an optional part only if that is there", () => {
    const schema = { type: "object", properties: { at: GOAL.$defs.Point } };
    expect(missing({}, schema, schema)).toEqual([]);
    expect(missing({ at: {} }, schema, schema)).toHaveLength(2);
  });
});

describe("what is wrong with a number", () => {
  const told = (value: unknown, schema: object): string[] => faults(value, schema).map((one) => one.message);

  it("is told in words, with the limit as the language writes it", async () => {
    expect(told("1,5", { type: "number" })).toEqual(["Enter a number."]);
    expect(told(1.5, { type: "integer" })).toEqual(["Enter a whole number."]);
    expect([...told(3, { maximum: 2.5 }), ...told(-3, { minimum: -2.5 })]).toEqual(["Enter a number of at most 2.5.", "Enter a number of at least -2.5."]);
    expect([...told(0, { exclusiveMinimum: 0 }), ...told(1e-7, { exclusiveMaximum: 1e-7 })]).toEqual(["Enter a number above 0.", "Enter a number below 1e-7."]);
    await language.choose("de");
    expect(told(3, { maximum: 2.5 })).toEqual(["Enter a number of at most 2,5."]);
    await language.choose("en");
  });
});

describe("steps of joints", () => {
  it.each([
    [-2.8, 2.8, [0.01, 0.1, 0.5]],
    [0, 0.08, [0.0002, 0.002, 0.01]],
    [-360, 360, [2, 20, 100]],
  ])("are round for %f to %f", (least, most, steps) => {
    const found = stepsOf([{ field: "", name: "", unit: "rad", least, most }]);
    expect(found).toEqual([...found].sort((a, b) => a - b));
    expect(found).toEqual(steps);
  });
});

describe("numbers that are typed", () => {
  it("keep their digits where a double would change them", () => {
    const schema = { anyOf: [{ type: "number" }, { $ref: "#/$defs/Odd" }], $defs: { Odd: { enum: ["NaN"] } } };
    expect([spells("NaN", schema, schema), spells("1.500", schema, schema), spells("1,5", { type: "number" }, schema)]).toEqual([true, false, false]);
    expect([numberOf("1.50"), numberOf("9007199254740993"), numberOf("north")]).toEqual([1.5, "9007199254740993", "north"]);
  });
});

import { describe, expect, it } from "vitest";

import { type Anchor, declutter, type Wish } from "../src/lib/labels.ts";

const SIDES: Anchor[] = [[0, 0.5], [1, 0.5]]; // to the right, to the left
const wish = (key: string, x: number, y = 0): Wish => ({ key, x, y, width: 10, height: 2 });
const placed = (wishes: Wish[], before = new Map<string, number>(), taken: any[] = []): Record<string, number> => Object.fromEntries(declutter(wishes, () => SIDES, taken, before));

describe("labels", () => {
  it("stand on the first side that is free, the first ones first", () => {
    expect(placed([wish("a", 0), wish("b", 20)])).toEqual({ a: 0, b: 0 });
    expect(placed([wish("a", 0), wish("b", 0)])).toEqual({ a: 0, b: 1 });
    expect(placed([wish("a", 0), wish("b", 0), wish("c", 0)])).toEqual({ a: 0, b: 1 });
  });

  it("stay where they were, so that nothing jumps when there is room again", () => {
    expect(placed([wish("a", 0), wish("b", 30)], new Map([["a", 0], ["b", 1]]))).toEqual({ a: 0, b: 1 });
  });

  it("keep off what is taken", () => {
    expect(placed([wish("a", 0)], new Map(), [{ left: 2, right: 3, low: -1, high: 1 }])).toEqual({ a: 1 });
  });

  it("may touch, and one above the other do not disturb", () => {
    expect(placed([wish("a", 0), wish("b", 10), wish("c", 0, 2)])).toEqual({ a: 0, b: 0, c: 0 });
  });
});

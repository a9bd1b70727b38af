import { Vector3 } from "three";
import { describe, expect, it } from "vitest";

import { Frames } from "../src/lib/scene/frames.ts";
import { Grid } from "../src/lib/scene/grid.ts";

const link = (child: unknown, x: number, rotation?: object): any => ({ header: { frame_id: "map" }, child_frame_id: child, transform: { translation: { x, y: 0, z: 0 }, rotation } });
const at = (frames: Frames, name: string): number[] | undefined => frames.between(name, "map") && new Vector3(1, 0, 0).applyMatrix4(frames.between(name, "map")!).toArray();

describe("frames", () => {
  it("stay where they were while what is told of them is no place, and the others are taken", () => {
    const frames = new Frames();
    frames.take({ transforms: [link("base", 1)] }, "tf");
    expect(() => frames.take({ transforms: [link("base", NaN), null, 5, link("tool", 2), link("far", 1e300)] }, "tf")).toThrow("base: its pose has something that is not a number");
    expect([at(frames, "base"), at(frames, "tool"), at(frames, "far")]).toEqual([[2, 0, 0], [3, 0, 0], undefined]);
  });

  it("are as large as they were, whatever the length of a rotation", () => {
    const frames = new Frames();
    frames.take({ transforms: [link("none", 0, { x: 0, y: 0, z: 0, w: 0 }), link("turned", 0, { x: 0, y: 0, z: 5, w: 5 })] }, "tf");
    expect(at(frames, "none")).toEqual([1, 0, 0]);
    expect(at(frames, "turned")).toEqual([expect.closeTo(0), expect.closeTo(1), 0]);
  });

  it("may have names that are no texts", () => {
    const frames = new Frames();
    frames.take(link(7, 1), "tf");
    expect(at(frames, "7")).toEqual([2, 0, 0]);
  });
});

describe("grids", () => {
  const grid = (width: number, height: number, count: number, more: object = {}): any => ({ info: { resolution: 1, width, height, ...more }, data: Array(count).fill(0) });

  it.each([
    [grid(-2, -2, 4), "its size is -2 x -2"],
    [grid(2.5, 2, 5), "its size is 2.5 x 2"],
    [grid(0, 0, 0), "its size is 0 x 0"],
    [grid(3, 3, 8), "it has 8 cells, not 3 x 3"],
    [grid(20_000, 1, 20_000), "it is 20000 x 1 cells large: 8192 a side is the most"],
    [grid(1, 1, 1, { origin: { position: { x: NaN, y: 0, z: 0 } } }), "its pose has something that is not a number"],
    [grid(1, 1, 1, { resolution: NaN }), "its resolution is not above zero"],
  ])("that are none are refused: %#", (wrong, why) => {
    expect(() => new Grid(wrong, true)).toThrow(why);
  });

  it("refuse parts that lie outside of them", () => {
    const made = new Grid(grid(4, 4, 16), true);
    expect(() => made.patch({ x: 3, y: 0, width: 2, height: 1, data: [1, 1] })).toThrow("an update lies outside of it");
    expect(() => made.patch({ x: 3, y: 3, width: -1, height: -1, data: [1] })).toThrow("its size is -1 x -1");
  });
});

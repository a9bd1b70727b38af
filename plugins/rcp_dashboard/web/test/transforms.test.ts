import { describe, expect, it } from "vitest";

import { lineOf, mean, paired, rate, type Samples, unitShown, within, written } from "../src/lib/transforms.ts";

const samples = (...pairs: [time: number, value: number][]): Samples => ({ times: Float64Array.from(pairs, ([time]) => time), values: Float64Array.from(pairs, ([, value]) => value) });

describe("rate", () => {
  it("is the slope between neighbours, at the time of the later one, however far they are apart", () => {
    const { times, values } = rate(samples([0, 1], [0.5, 2], [2.5, -2]));
    expect([...times]).toEqual([0.5, 2.5]);
    expect([...values]).toEqual([2, -2]);
  });

  it("has nothing to tell of one sample, or of none", () => {
    expect(rate(samples([1, 1])).values).toHaveLength(0);
    expect(rate(samples()).values).toHaveLength(0);
  });
});

describe("mean", () => {
  it("counts the samples of the last seconds, without the one that is exactly so old", () => {
    expect([...mean(samples([0, 2], [1, 4], [2, 6], [3, 100]), 2).values]).toEqual([2, 3, 5, 53]);
  });

  it("goes on after what is no number", () => {
    expect([...mean(samples([0, 2], [1, NaN], [2, 4]), 5).values]).toEqual([2, 2, 3]);
  });

  it("is the sample itself after a gap", () => {
    expect([...mean(samples([0, 1000], [100, 5]), 10).values]).toEqual([1000, 5]);
  });
});

describe("x and y", () => {
  it("meets the times of x with y between its samples, and leaves out what lies beyond", () => {
    const found = paired(samples([0, 0], [1, 10], [2, 20], [9, 90]), samples([1, 1], [3, 3]));
    expect(found).toEqual({ xs: [10, 20], ys: [1, 2] });
  });

  it("is empty where one of both is not known", () => {
    expect(paired(samples([0, 0]), samples()).xs).toEqual([]);
  });
});

describe("a line", () => {
  it("is read as it was written", () => {
    for (const id of ["/a/b#x.y", "/a/b#x.y~rate", "/a/b#~mean5", "/a/b#x~mean0.5"]) expect(written(lineOf(id), lineOf(id).shown)).toBe(id);
  });

  it("takes a name that only looks so for a field", () => {
    expect(lineOf("/a#x~median").field).toBe("x~median");
    expect(lineOf("/a#x~mean0").shown).toEqual({ what: "value" });
    expect(lineOf("/a#x~mean99999").shown).toEqual({ what: "value" });
  });

  it("has a unit of its own where it shows a rate", () => {
    expect([unitShown("m", { what: "rate" }), unitShown("", { what: "rate" }), unitShown("m", { what: "mean", seconds: 1 })]).toEqual(["m/s", "1/s", "m"]);
    expect(["m/s", "rad/s2", "Cel"].map((unit) => unitShown(unit, { what: "rate" }))).toEqual(["m/s2", "rad/s3", "Cel/s"]);
  });
});

describe("a part", () => {
  it("reaches from the sample before its begin to the one behind its end", () => {
    expect([...within(samples([0, 0], [1, 1], [2, 2], [3, 3], [4, 4]), 1.5, 2.5).times]).toEqual([1, 2, 3]);
  });
});

import { describe, expect, it } from "vitest";

import { incidentsOf, marksOf, momentOf, type Recording, stretches } from "../src/lib/incidents.ts";

const iso = (second: number): string => new Date(second * 1000).toISOString();
const file = (name: string, from: number, to?: number, at?: number): Recording => ({
  path: `${name}.${from}`, name, tenant: "alpha", state: to === undefined ? "recording" : "kept", start: iso(from), bytes: 1, messages: 1, ...(to !== undefined && { end: iso(to) }), ...(at !== undefined && { at: iso(at) }),
});

describe("incidents", () => {
  it("are where they happened, not where what was before begins", () => {
    expect(momentOf(file("incident", 10, 40, 30))).toBe(30_000);
    expect(momentOf(file("incident", 10, 40))).toBe(10_000);
  });

  it("are in the order of time, and those that are near to each other are one mark", () => {
    const all = incidentsOf([file("always", 0), file("incident", 50, 60), file("incident", 10, 20), file("incident", 11, 20), file("incident", 500, 600)]);
    expect(all.map(momentOf)).toEqual([10_000, 11_000, 50_000, 500_000]);
    expect(marksOf(all, 0, 100_000, 5000).map((one) => one.incidents.length)).toEqual([2, 1]);
  });
});

describe("what was recorded", () => {
  it("is shown without short gaps, within the time line, and to its end while it goes on", () => {
    const all = [file("always", -50, 20), file("always", 21, 40), file("drive", 60, 70), file("always", 90)];
    expect(stretches(all, 0, 100_000, 2000)).toEqual([
      { from: 0, to: 0.4 },
      { from: 0.6, to: 0.7 },
      { from: 0.9, to: 1 },
    ]);
  });
});

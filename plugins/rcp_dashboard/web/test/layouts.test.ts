import { describe, expect, it } from "vitest";

import { added, checked, content, full, type Layout, moved, panelOf, panelsOf, removed, shifted } from "../src/lib/layouts/document.ts";
import { linkOf, placeOf } from "../src/lib/layouts/links.ts";

const of = (...columns: string[][]): Layout => ({ columns: columns.map((titles) => ({ size: 1, panels: titles.map((title) => panelOf("note", { title })) })) });
const shape = ({ columns }: Layout): (string | undefined)[][] => columns.map(({ panels }) => panels.map(({ title }) => title));
const id = (layout: Layout, title: string): number => panelsOf(layout).find((one) => one.title === title)!.id;

describe("a kept layout", () => {
  it("comes back as it was", () => {
    const made = { columns: [{ size: 2, panels: [panelOf("gauge", { path: "/a", field: "x", low: -1, high: 1, size: 0.5 }), panelOf("plot", { plots: [["/a#x~rate", "xy", "/a#y"]], seconds: 60 })] }] };
    expect(content(checked(content(made)))).toEqual(content(made));
  });

  it("is what of it can be used, whoever wrote it", () => {
    for (const odd of [null, [], "rows", { columns: 5 }, { columns: [null, { panels: "x" }, { panels: [{ kind: "bomb" }, 7, null] }] }]) expect(checked(odd)).toEqual({ columns: [] });
    const [one] = panelsOf(checked({ columns: [{ size: -4, panels: [{ kind: "note", size: "big", text: 5, low: Infinity, paths: { a: 1, b: "/b" }, html: "<b>" }] }] }));
    expect(one).toEqual({ id: one!.id, kind: "note", size: 1, paths: { b: "/b" } });
  });

  it("has so many panels and no more", () => {
    const many = checked({ columns: Array.from({ length: 30 }, () => ({ panels: [{ kind: "note" }] })) });
    expect(panelsOf(many)).toHaveLength(24);
    expect(full(many)).toBe(true);
    expect(added(many, panelOf("log"))).toBe(many);
  });
});

describe("a panel", () => {
  it("moves within its column, and to the one beside it at the same height", () => {
    const layout = of(["a", "b"], ["c"]);
    expect(shape(moved(layout, id(layout, "a"), "down"))).toEqual([["b", "a"], ["c"]]);
    expect(shape(moved(layout, id(layout, "b"), "right"))).toEqual([["a"], ["c", "b"]]);
    expect(shape(moved(layout, id(layout, "c"), "left"))).toEqual([["c", "a", "b"]]);
  });

  it("gets a column of its own beyond the last one, and stays where it is alone in it", () => {
    const layout = of(["a", "b"], ["c"]);
    expect(shape(moved(layout, id(layout, "a"), "left"))).toEqual([["a"], ["b"], ["c"]]);
    expect(moved(layout, id(layout, "c"), "right")).toBe(layout);
    expect(moved(layout, id(layout, "a"), "up")).toBe(layout);
  });

  it("takes an empty column with it", () => {
    const layout = of(["a"], ["b"]);
    expect(shape(removed(layout, id(layout, "a")))).toEqual([["b"]]);
  });

  it("is added beside the others, then below the fewest", () => {
    let layout = of(["a"]);
    for (const title of ["b", "c", "d"]) layout = added(layout, panelOf("note", { title }));
    expect(shape(layout)).toEqual([["a", "d"], ["b"], ["c"]]);
  });
});

describe("a border", () => {
  it("gives to the one side what it takes from the other", () => {
    expect(shifted([1, 1, 2], 0, 0.125)).toEqual([1.5, 0.5, 2]);
  });

  it("leaves both sides a size that can be used", () => {
    const [first, second] = shifted([1, 1], 0, -5);
    expect(first).toBeGreaterThan(0.1);
    expect(first! + second!).toBeCloseTo(2);
    expect(shifted([1, 1], 1, 0.5)).toEqual([1, 1]);
  });
});

describe("a link", () => {
  it("leads to the layout that it was made of, whatever its name is", () => {
    for (const place of [{ name: "main" }, { name: "100 % / ü?#", tenant: "alpha" }, { name: "all", tenant: "*" }]) {
      const [owner, name] = linkOf(place, "ada").replace("#/layout/", "").split("/").map(decodeURIComponent) as [string, string];
      expect(placeOf(owner, name, "ada")).toEqual(place);
    }
  });

  it("of somebody's own is nobody else's", () => {
    expect(placeOf("bob", "main", "ada")).toEqual({ name: "main", other: "bob" });
  });
});

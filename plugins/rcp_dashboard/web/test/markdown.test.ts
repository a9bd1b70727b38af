import { describe, expect, it } from "vitest";

import { blocks, spans } from "../src/lib/layouts/markdown.ts";

describe("a line", () => {
  it("has bold, italic, code and links", () => {
    expect(spans("a **b** *c* `d *e*` [f](https://x.y/z)")).toEqual([
      { kind: "text", text: "a " },
      { kind: "bold", text: "b" },
      { kind: "text", text: " " },
      { kind: "italic", text: "c" },
      { kind: "text", text: " " },
      { kind: "code", text: "d *e*" },
      { kind: "text", text: " " },
      { kind: "link", text: "f", href: "https://x.y/z" },
    ]);
  });

  it("makes no link of what would run, nor of what is no page", () => {
    for (const href of ["javascript:alert(1)", "data:text/html,x", "//evil.example", " https://x", "/etc"]) expect(spans(`[go](${href})`).every((one) => one.kind !== "link")).toBe(true);
    expect(spans("[here](#/plot)")[0]).toEqual({ kind: "link", text: "here", href: "#/plot" });
  });

  it("leaves signs alone that mean nothing", () => {
    expect(spans("2 * 3 * 4 and [x]")).toEqual([{ kind: "text", text: "2 * 3 * 4 and [x]" }]);
    expect(spans("<img src=x onerror=alert(1)>")).toEqual([{ kind: "text", text: "<img src=x onerror=alert(1)>" }]);
  });
});

describe("a note", () => {
  it("has headings, paragraphs, lists and code", () => {
    expect(blocks("# A\nb\nc\n\n- d\n- e\n1. f\n```\n# g\n```").map((one) => one.kind)).toEqual(["heading", "paragraph", "list", "list", "code"]);
    expect(blocks("- d\n- e")).toEqual([{ kind: "list", ordered: false, items: [[{ kind: "text", text: "d" }], [{ kind: "text", text: "e" }]] }]);
  });

  it("ends with code that nobody has closed", () => {
    expect(blocks("```\na\nb")).toEqual([{ kind: "code", text: "a\nb" }]);
    expect(blocks("")).toEqual([]);
  });
});

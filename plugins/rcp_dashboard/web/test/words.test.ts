import { describe, expect, it } from "vitest";

import { counted, language, say } from "../src/lib/language.svelte.ts";
import { fault, merged, read, write } from "../words/catalogue.ts";
import { collect } from "../words/collect.ts";
import { translate } from "../words/texts.ts";

const sources = import.meta.glob<string>("../src/**/*.{svelte,ts}", { query: "?raw", import: "default", eager: true });
const catalogues = import.meta.glob<string>("../words/*.po", { query: "?raw", import: "default", eager: true });
const { texts, early } = collect(Object.entries(sources).map(([file, source]) => [file.replace("../", ""), source]));
const UPDATE = "python plugins/rcp_dashboard/web/build.py --words brings the catalogue to the texts";

describe("catalogues", () => {
  it.each(Object.entries(catalogues))("%s has every text of the pages, translated", (_, po) => {
    const { header, entries } = read(po);
    const now = merged(entries, texts, 2);
    expect([...now.keys()].filter((key) => !entries.has(key)), UPDATE).toEqual([]);
    expect([...entries.keys()].filter((key) => !now.has(key)), UPDATE).toEqual([]);
    expect([...now.values()].filter((entry) => fault(entry)).map((entry) => `${entry.one}: ${fault(entry)}`)).toEqual([]);
    expect(write(header, now.values()), UPDATE).toBe(po);
  });

  it("have one word for one thing", () => {
    const { entries } = read(catalogues["../words/de.po"] as string);
    const told = [...entries.values()].filter(({ one }) => one.startsWith("its scale ")).map((entry) => entry.told[0]);
    expect(told).toHaveLength(3);
    for (const one of told) expect(one).toMatch(/^seine Größe /);
  });

  it("are asked at the time when a text is shown", () => {
    expect(early, "put it into a function, or make it a property of an object").toEqual([]);
  });

  it("tell a translation that has other places, or none", () => {
    const entry = { one: "{0} of {1} robots", files: [] };
    expect(fault({ ...entry, told: ["{1} Roboter, davon {0}"] })).toBe("");
    expect(fault({ ...entry, told: ["{0} Roboter"] })).toContain("places");
    expect(fault({ ...entry, told: [""] })).toBe("not translated");
  });
});

describe("the build", () => {
  const code = (source: string, file = "a.svelte"): string => translate(source, file).code;

  it("looks up texts of the markup, with what is between them", () => {
    expect(code('<script lang="ts">let n = 1;</script><p>\n  Found {n} of them\n</p>')).toContain('<p>\n  {say_("Found {0} of them", (n))}\n</p>');
  });

  it("looks up attributes for people, and leaves the others", () => {
    const made = code('<button title="Log in to {where}" class="Big one" data-x="Some words">{open ? "on" : "off"}</button>');
    expect(made).toContain('title={say_("Log in to {0}", (where))}');
    expect(made).toContain('class="Big one" data-x="Some words"');
    expect(made).toContain('{open ? say_("on") : say_("off")}');
  });

  it("leaves what is compared, keys and paths", () => {
    const source = 'export const a = (one: string) => one === "Some words" || get("Some Key") || fetch(`/rcp/${one}`) || one in { "Two words": 1 };';
    expect(code(source, "a.ts")).toBe(source);
  });

  it("reads properties of constants anew in each language", () => {
    expect(code('const WORDS = { arm: "Arm it", n: 1 };', "a.ts")).toContain('{ get arm() { return say_("Arm it"); }, n: 1 }');
    expect(translate('const WORD = "Arm it";', "a.ts").early).toEqual(["Arm it"]);
  });

  it("chooses by the number where the source does", () => {
    expect(code('const a = (n: number) => `${n} ${n === 1 ? "robot" : "robots"}`;', "a.ts")).toContain('${count_((n), "robot", "robots")}');
  });

  it("keeps texts within texts", () => {
    const made = code('const a = (n?: string) => `Stop ${n ? `the robot ${n}` : "all of them"} now`;', "a.ts");
    expect(made).toContain('say_("Stop {0} now", (n ? say_("the robot {0}", (n)) : say_("all of them")))');
  });
});

describe("the page", () => {
  it("speaks English without a catalogue, and German with it", async () => {
    expect(say("{0} of {1} robots", 2, 3)).toBe("2 of 3 robots");
    expect([0, 1, 2].map((n) => counted(n, "needs", "need"))).toEqual(["need", "needs", "need"]);
    await language.choose("de");
    expect(language.code).toBe("de");
    expect(say("{0} of {1} robots", 2, 3)).toBe("2 von 3 Robotern");
    expect(say("a text that is in no catalogue, {0}", 1)).toBe("a text that is in no catalogue, 1");
    expect([0, 1, 2].map((n) => counted(n, "needs", "need"))).toEqual(["brauchen", "braucht", "brauchen"]);
  });
});

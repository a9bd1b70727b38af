/** Vite: puts the look-up around every text of the pages, and serves the catalogues to them. */
import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";

import type { Plugin } from "vite";

import { compiled, read } from "./catalogue.ts";
import { has } from "./collect.ts";
import { translate } from "./texts.ts";

const HERE = fileURLToPath(new URL(".", import.meta.url));
const SOURCE = fileURLToPath(new URL("../src/", import.meta.url));
const VIRTUAL = "virtual:words/";

export function words(): Plugin {
  return {
    name: "words",
    enforce: "pre",
    resolveId: (id) => (id.startsWith(VIRTUAL) ? `\0${id}` : undefined),
    load(id) {
      if (!id.startsWith(`\0${VIRTUAL}`)) return undefined;
      const file = `${HERE}${id.slice(VIRTUAL.length + 1)}.po`;
      this.addWatchFile(file);
      return `export default ${JSON.stringify(compiled(read(readFileSync(file, "utf8")).entries))};`;
    },
    transform(code, id) {
      // Tests see the source as it is.
      if (process.env["VITEST"] || !id.startsWith(SOURCE) || !has(id)) return undefined;
      return { code: translate(code, id).code, map: null };
    },
  };
}

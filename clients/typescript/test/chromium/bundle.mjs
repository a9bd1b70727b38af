// Writes the tests of client.test.ts as one script for a page: node bundle.mjs FILE
import { join } from "node:path";
import { rolldown } from "rolldown";

const here = import.meta.dirname;
const bundle = await rolldown({
  input: join(here, "..", "client.test.ts"),
  platform: "browser",
  resolve: {
    alias: { "node:test": join(here, "node_test.ts"), "node:assert/strict": join(here, "node_assert.ts") },
  },
});
await bundle.write({ file: process.argv[2], format: "iife" });

import { fileURLToPath } from "node:url";

import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";

import { words } from "./words/plugin.ts";

const client = (file: string): string => fileURLToPath(new URL("../../../clients/typescript/src/", import.meta.url)) + file;

export default defineConfig({
  base: "./", // the page works below any prefix
  plugins: [words(), svelte()],
  resolve: {
    alias: [
      { find: /^rcp-client$/, replacement: client("index.ts") },
      { find: /^rcp-client\/(.*)$/, replacement: client("$1.ts") },
      { find: "@msgpack/msgpack", replacement: fileURLToPath(new URL("node_modules/@msgpack/msgpack", import.meta.url)) },
    ],
  },
  build: {
    outDir: "../static",
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0, // nothing inline: the Content-Security-Policy allows only files
    modulePreload: { polyfill: false },
    license: { fileName: "licenses.md" }, // of what is bundled
    chunkSizeWarningLimit: 1200, // kB: MapLibre and three, which only the map and the scene load
  },
  server: { proxy: { "/rcp": { target: "http://127.0.0.1:8080", ws: true }, "/dashboard": "http://127.0.0.1:8080" } },
});

import { fileURLToPath } from "node:url";

import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";

export default defineConfig({
  base: "./", // the page works below any prefix
  plugins: [svelte()],
  resolve: {
    alias: { "rcp-client": fileURLToPath(new URL("../../../clients/typescript/src/index.ts", import.meta.url)) },
  },
  build: {
    outDir: "../static",
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0, // nothing inline: the Content-Security-Policy allows only files
    modulePreload: { polyfill: false },
    license: { fileName: "licenses.md" }, // of what is bundled
    chunkSizeWarningLimit: 900, // kB: three, which only the scene loads
  },
  server: { proxy: { "/rcp": { target: "http://127.0.0.1:8080", ws: true }, "/dashboard": "http://127.0.0.1:8080" } },
});

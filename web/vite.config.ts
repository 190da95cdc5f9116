import { defineConfig } from "vitest/config";

// The page is served by the station itself, possibly behind no internet at all: everything
// it needs is in dist/, and nothing is inlined that the Content-Security-Policy would refuse.
export default defineConfig({
  base: "./",
  oxc: { jsx: { runtime: "automatic", importSource: "preact" } },
  build: { target: "es2022", assetsInlineLimit: 0, chunkSizeWarningLimit: 1500, sourcemap: false },
  worker: { format: "es" },
  server: {
    proxy: {
      "/api": { target: "http://127.0.0.1:8000", ws: true },
    },
  },
  test: { include: ["tests/**/*.test.ts"], environment: "node" },
});

import { defineConfig } from 'vite'

// The renderer without the app, for tests/client; the output folder is given on the command line and is never shipped.
export default defineConfig({
  base: './',
  build: { target: 'es2022', minify: false, emptyOutDir: true, rollupOptions: { input: 'harness.html' } },
})

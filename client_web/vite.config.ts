import { defineConfig } from 'vitest/config'

// The build lands inside the Python package, which ships and serves it.
export default defineConfig({
  base: './',
  build: {
    outDir: '../server/nearfield_server/static',
    emptyOutDir: true,
    target: 'es2022',
    chunkSizeWarningLimit: 900,
    rollupOptions: { input: ['index.html', 'setup.html', 'status.html'] },
  },
  worker: { format: 'es' },
  server: {
    fs: { allow: ['..'] },
    proxy: {
      '/api': 'http://127.0.0.1:8080',
      '/assets': 'http://127.0.0.1:8080',
      '/ws': { target: 'ws://127.0.0.1:8080', ws: true },
    },
  },
  test: { include: ['src/**/*.test.ts'], setupFiles: ['vitest.setup.ts'] },
})

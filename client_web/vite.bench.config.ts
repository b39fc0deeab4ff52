import { defineConfig } from 'vite'

// The client benchmark of `nearfield bench`: beside the client in a checkout, never in the wheel.
export default defineConfig({
  root: 'bench',
  base: './',
  build: {
    outDir: '../../server/nearfield_server/static_bench',
    emptyOutDir: true,
    target: 'es2022',
    chunkSizeWarningLimit: 4000,
  },
})

// The page with a stand-in for the renderer; OUT_DIR is a temporary folder of the test.
export default {
  base: './',
  publicDir: '../../../client_web/public',
  build: { outDir: process.env.OUT_DIR, emptyOutDir: true, target: 'es2022' },
  worker: { format: 'es' },
  logLevel: 'warn',
}

import type { FrameReport, PictureRenderer } from './ports'

/** Software renderers compile shaders for minutes when the machine is busy. */
const TIMEOUT_MS = 240_000

/**
 * Renders until nothing is left over.
 *
 * @throws Error when the renderer does not come to an end.
 */
export async function renderUntilDone(renderer: PictureRenderer): Promise<FrameReport> {
  const start = performance.now()
  while (performance.now() - start < TIMEOUT_MS) {
    const report = renderer.render(performance.now())
    if (!report.pending) {
      return report
    }
    // What is pending may arrive by events; let them happen.
    await new Promise((resolve) => window.setTimeout(resolve, 0))
  }
  throw new Error(`The renderer did not finish the picture within ${TIMEOUT_MS / 1000} s.`)
}

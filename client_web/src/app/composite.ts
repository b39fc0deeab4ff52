import type { SceneDescription } from '../state/sceneDescription'
import type { FrameReport, PictureRenderer } from './ports'
import type { Viewer } from './viewer'

/** How a composite is drawn. */
export interface CompositeQuality {
  /** Every shadow map fresh, full meshes as casters, larger maps, more taps. */
  readonly fullQuality: boolean
  /** Of the picture's size against that of the view's calibration. */
  readonly scale: number
}

export const FULL_COMPOSITE: CompositeQuality = { fullQuality: true, scale: 1 }

/** Linear radiance, 4 floats per pixel, row 0 on top. */
export interface Composite {
  readonly width: number
  readonly height: number
  readonly rgba: Float32Array
}

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

/**
 * Sets a renderer to a tablet view in the size of its calibration, scaled.
 *
 * @throws RangeError where there is no such view.
 */
export function aimAtView(
  renderer: PictureRenderer,
  scene: SceneDescription,
  viewIndex: number,
  quality: CompositeQuality,
): void {
  const view = scene.views[viewIndex]
  if (!view) {
    throw new RangeError(`view ${viewIndex}: expected 0 to ${scene.views.length - 1}`)
  }
  const { width, height } = compositeSize(view, quality)
  renderer.setOptions({ fullQuality: quality.fullQuality })
  renderer.setSize(width, height)
  renderer.setCamera({ kind: 'tablet', viewIndex })
}

/** Draws a tablet view with all that belongs to it and reads it back. */
export async function takeComposite(
  viewer: Viewer,
  viewIndex: number,
  quality: CompositeQuality = FULL_COMPOSITE,
): Promise<Composite> {
  let rgba = new Float32Array()
  await viewer.drawView(viewIndex, quality, async (renderer) => {
    const report = await renderUntilDone(renderer)
    rgba = renderer.readComposite() as Float32Array<ArrayBuffer>
    return report
  })
  const view = viewer.scene.views[viewIndex] as SceneDescription['views'][number]
  return { ...compositeSize(view, quality), rgba }
}

/** Draws one frame of a tablet view in live quality, and waits until it is drawn by reading it back: to measure what a frame costs. */
export function drawFrame(viewer: Viewer, viewIndex: number): Promise<void> {
  return viewer.drawView(viewIndex, { fullQuality: false, scale: 1 }, async (renderer) => {
    const report = renderer.render(performance.now())
    renderer.readComposite()
    return report
  })
}

function compositeSize(
  view: SceneDescription['views'][number],
  quality: CompositeQuality,
): { width: number; height: number } {
  const scaled = (pixels: number): number => Math.max(1, Math.round(pixels * quality.scale))
  return { width: scaled(view.width), height: scaled(view.height) }
}

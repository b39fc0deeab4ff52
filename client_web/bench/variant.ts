/** What the benchmark times: one way to draw the scene. */

/**
 * What is drawn. `full` moves everything in each frame: both virtual objects, all VALs and the camera picture, so that nothing of
 * the frame before can be kept. Ours then runs every pass (background, shadow maps of room and objects as many as it draws per
 * live frame, uploads, G-buffer, tiles, shading, coverage, resolve, display); the others redraw the shadow map of every light.
 * The other kinds change one thing only and show what a frame costs then.
 */
export const FRAME_KINDS = [
  'full',
  'video',
  'light colour',
  'lights moved',
  'objects moved',
  'camera',
] as const
export type FrameKind = (typeof FRAME_KINDS)[number]

export interface DrawingOptions {
  readonly shadows: boolean
  readonly lights: boolean
}

export interface Variant {
  readonly canvas: HTMLCanvasElement
  readonly gl: WebGL2RenderingContext
  /** Draws one frame to the canvas, the state of frame number `frame`. */
  draw(frame: number, kind: FrameKind): void
  dispose(): void
}

/** Waits until the frame is drawn: reads one pixel of the canvas, which was the last target. */
export function finishFrame(gl: WebGL2RenderingContext): void {
  gl.bindFramebuffer(gl.FRAMEBUFFER, null)
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4))
}

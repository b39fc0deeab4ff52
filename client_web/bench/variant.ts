/** What the benchmark times: one way to draw the scene. */

/**
 * What changes from frame to frame.
 *
 * `full` moves everything: all virtual objects, all VALs, and the camera picture, so that nothing of the frame before can be kept.
 * Ours then runs every pass with the options of a live picture: background, shadow maps of room and objects (as many per frame as it
 * allows itself, the rest follows in later frames), uploads, G-buffer, tile lists, shading with soft shadows and indirect exchange,
 * coverage, resolve, display. The other renderers redraw the shadow map of every light; they draw without anti-aliasing, without
 * light from the room beyond a constant, and, but for differential rendering, without a camera picture.
 *
 * `same maps` is `full`, but PlayCanvas gives a new shadow map to as many lights only as ours does in a frame, in turn.
 *
 * The other kinds change one thing only and show what a frame of ours costs then. `video` is a new camera picture and nothing else.
 */
export const FRAME_KINDS = [
  'full',
  'same maps',
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

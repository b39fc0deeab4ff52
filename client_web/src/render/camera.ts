/** Rasterisation of calibrated pinhole cameras. Camera axes are OpenCV's, also here; only clip space is OpenGL's. */
import { invertRigid, multiply4 } from './vector'

/** Metres. In front of every surface that a tablet can look at, and far enough for depth: 1 - near / z. */
export const NEAR = 0.05

export interface Lens {
  readonly width: number
  readonly height: number
  readonly fx: number
  readonly fy: number
  readonly cx: number
  readonly cy: number
}

/** The same field of view with another number of pixels. */
export function resizeLens(lens: Lens, width: number, height: number): Lens {
  const sx = width / lens.width
  const sy = height / lens.height
  return {
    width,
    height,
    fx: lens.fx * sx,
    fy: lens.fy * sy,
    cx: (lens.cx + 0.5) * sx - 0.5,
    cy: (lens.cy + 0.5) * sy - 0.5,
  }
}

/** Square pixels, principal point in the middle. */
export function centredLens(width: number, height: number, verticalFov: number): Lens {
  const focal = height / 2 / Math.tan(verticalFov / 2)
  return { width, height, fx: focal, fy: focal, cx: (width - 1) / 2, cy: (height - 1) / 2 }
}

/** Column-major; far plane at infinity, so window depth is 1 - NEAR / z. */
export function clipFromCamera(lens: Lens): Float32Array {
  const m = new Float32Array(16)
  m[0] = (2 * lens.fx) / lens.width
  m[5] = (-2 * lens.fy) / lens.height
  m[8] = (2 * lens.cx + 1) / lens.width - 1
  m[9] = 1 - (2 * lens.cy + 1) / lens.height
  m[10] = 1
  m[11] = 1
  m[14] = -2 * NEAR
  return m
}

export function clipFromWorld(lens: Lens, worldFromCamera: ArrayLike<number>): Float32Array {
  return multiply4(clipFromCamera(lens), invertRigid(worldFromCamera))
}

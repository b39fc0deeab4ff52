/** Rays through points of the picture. Camera axes are OpenCV's, pixel centres are integers (protocol/CONVENTIONS.md). */
import { type Matrix4, Vector3 } from 'three'

export interface Ray {
  readonly origin: Vector3
  /** Unit, world. */
  readonly direction: Vector3
}

export interface PinholeLens {
  readonly width: number
  readonly height: number
  readonly fx: number
  readonly fy: number
  readonly cx: number
  readonly cy: number
}

/** The lens of a free camera: square pixels, principal point in the middle. */
export function freeLens(verticalFov: number, aspect: number): PinholeLens {
  const height = 1000
  const width = height * aspect
  const focal = height / 2 / Math.tan(verticalFov / 2)
  return { width, height, fx: focal, fy: focal, cx: (width - 1) / 2, cy: (height - 1) / 2 }
}

/** The ray through normalised device coordinates (-1..1, y up) of a picture that is filled by the lens. */
export function cameraRay(worldFromCamera: Matrix4, lens: PinholeLens, xNdc: number, yNdc: number): Ray {
  const pixelX = ((xNdc + 1) / 2) * lens.width - 0.5
  const pixelY = ((1 - yNdc) / 2) * lens.height - 0.5
  const direction = new Vector3((pixelX - lens.cx) / lens.fx, (pixelY - lens.cy) / lens.fy, 1)
  return {
    origin: new Vector3().setFromMatrixPosition(worldFromCamera),
    direction: direction.transformDirection(worldFromCamera),
  }
}

/** What the passes of one frame share. */
import type { Lens } from '../camera'
import type { DataTexture } from '../gl/targets'
import type { ObjectState } from '../objectData'
import type { RendererOptions } from '../types'

export interface CameraState {
  readonly kind: 'tablet' | 'free'
  readonly viewIndex: number
  readonly lens: Lens
  /** Column-major. */
  readonly worldFromCamera: Float32Array
  readonly clipFromWorld: Float32Array
  /** The background is a picture; otherwise the room drawn from its atlas. */
  readonly hasPicture: boolean
}

export interface Frame {
  readonly camera: CameraState
  readonly options: RendererOptions
  readonly objects: readonly ObjectState[]
  readonly valData: DataTexture
  readonly objectData: DataTexture
  readonly valCount: number
}

/** Uniforms of chunks/surface.glsl. */
export function lensUniform(lens: Lens): [number, number, number, number] {
  return [lens.fx, lens.fy, lens.cx, lens.height - 1 - lens.cy]
}

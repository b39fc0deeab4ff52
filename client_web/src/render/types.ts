/** Data that crosses the border of the renderer. Units and frames: protocol/CONVENTIONS.md. */
import type { RoomTriangles } from '../interaction/roomSurface'
import type { Ground } from './groundContact'

/** A triangle list with what its pass needs per vertex. */
export interface MeshData {
  readonly positions: Float32Array
  readonly normals: Float32Array
  readonly indices: Uint32Array
}

/** The reconstructed room, world axes. */
export interface RoomAsset extends MeshData {
  /** 3 per vertex, linear diffuse albedo of the vertex's material. */
  readonly albedo: Float32Array
  /** 2 per vertex, place in the radiance atlas. */
  readonly uv: Float32Array
}

/** Occlusion of one object on a lattice: (nz, ny, nx, 12) half floats, object axes. */
export interface OcclusionFieldAsset {
  readonly resolution: readonly [number, number, number]
  readonly boxMin: readonly [number, number, number]
  readonly boxSize: readonly [number, number, number]
  readonly coeffs: Uint16Array
}

/** A prepared virtual object, object axes. */
export interface ObjectAsset extends MeshData {
  readonly name: string
  readonly albedo: readonly [number, number, number]
  /** Row-major. */
  readonly worldFromObject: readonly number[]
  readonly centre: readonly [number, number, number]
  readonly radius: number
  /** 9 per vertex each: transfer_coeffs, and self-interreflected transfer of order 1 and 2 per unit albedo. */
  readonly shadowed: Float32Array
  readonly bounce1: Float32Array
  readonly bounce2: Float32Array
  /** 9 per vertex: what the object loses to its own shadow on the surface that it stands on, per unit reflectance. */
  readonly groundShadow: Float32Array
  readonly bounceRatio: number
  readonly shadowProxy: { readonly positions: Float32Array; readonly indices: Uint32Array }
  readonly occlusionField: OcclusionFieldAsset | null
}

/** RGBA half floats, bottom row first. */
export interface HalfPicture {
  readonly width: number
  readonly height: number
  readonly data: Uint16Array
}

export interface ViewAsset {
  readonly width: number
  readonly height: number
  readonly fx: number
  readonly fy: number
  readonly cx: number
  readonly cy: number
  /** Row-major, OpenCV camera axes. */
  readonly worldFromCamera: readonly number[]
  /** One basis picture per light, or none. */
  readonly pictures: readonly HalfPicture[]
}

export interface LightAsset {
  readonly radiance: readonly [number, number, number]
  readonly basisRadiance: number
  readonly weight: number
}

export interface SceneAssets {
  readonly room: RoomAsset
  readonly objects: readonly ObjectAsset[]
  readonly views: readonly ViewAsset[]
  readonly lights: readonly LightAsset[]
  readonly roomTriangles: RoomTriangles & Ground
}

export interface RendererOptions {
  /** Factor on linear radiance before the display transform. */
  exposure: number
  shadows: boolean
  /** Indirect light between virtual objects and real surfaces. */
  indirectOcclusion: boolean
  showVals: boolean
  /** Outlined on the screen, never in the composite; -1 = none. */
  selectedObject: number
  antiAliasing: boolean
  /** Evaluation: all shadow maps in one frame, full meshes as casters, larger maps, more taps. */
  fullQuality: boolean
  /** Skip VALs that cannot matter in a tile; off only to check that nothing changes. */
  tiled: boolean
  /** Bends the brightest tones instead of clipping them. */
  softClip: boolean
  /** Off draws the papers' methods for the benchmark: what a lamp's own fixture hides counts as seen. */
  fixtureRays: boolean
  /** Off draws the papers' methods for the benchmark: the real room hides no light. */
  roomShadows: boolean
  /** On draws Gierlinger et al. 2010 for the benchmark: real surfaces take the share of the surrounding light that objects leave them. */
  receiverRatio: boolean
}

export const DEFAULT_OPTIONS: RendererOptions = {
  exposure: 1,
  shadows: true,
  indirectOcclusion: true,
  showVals: false,
  selectedObject: -1,
  antiAliasing: true,
  fullQuality: false,
  tiled: true,
  softClip: true,
  fixtureRays: true,
  roomShadows: true,
  receiverRatio: false,
}

/** 4x4 column-major, as three.js Matrix4 and interaction's Pose hold it. */
export interface MatrixLike {
  readonly elements: ArrayLike<number>
}

export type CameraChoice =
  | { readonly kind: 'tablet'; readonly viewIndex: number }
  | { readonly kind: 'free'; readonly worldFromCamera: MatrixLike; readonly verticalFov: number }

export interface PassReport {
  readonly name: string
  readonly ran: boolean
  readonly reason: string
}

export interface FrameStats {
  readonly passes: readonly PassReport[]
  /** Time spent in the page's thread, ms. */
  readonly cpuMs: number
  /** Work is left over: another frame must follow. */
  readonly pending: boolean
}

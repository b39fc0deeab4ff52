/** What an object's own shadow on the ground is multiplied with; the same rule as server/nearfield_server/scene/ground_shadow.py. */
import { castRay, type Triangles } from './rayMesh'
import { add, scale, transformPoint, type Vec3, vec3At } from './vector'

/** Radii of gap between object and surface at which the ground shadow is gone. */
const CONTACT_REACH = 0.2
/** Cosines of the tilt at which the ground shadow applies fully and not at all. */
const UPRIGHT = 0.99
const TILTED = 0.9
/** Where the rays start on the base: its middle and half-way to its corners. */
const STARTS = [
  [0, 0],
  [-1, -1],
  [-1, 1],
  [1, -1],
  [1, 1],
] as const

/** Real surfaces with what they reflect. */
export interface Ground extends Triangles {
  /** 3 per vertex, equal over a triangle. */
  readonly albedo: Float32Array
}

export interface Bounds {
  readonly low: Vec3
  readonly high: Vec3
}

const knownBounds = new WeakMap<Float32Array, Bounds>()

/** Corners of the bounding box of packed positions; computed once per array. */
export function boundsOf(positions: Float32Array): Bounds {
  const known = knownBounds.get(positions)
  if (known) return known
  const low = [Number.POSITIVE_INFINITY, Number.POSITIVE_INFINITY, Number.POSITIVE_INFINITY]
  const high = low.map((value) => -value)
  positions.forEach((value, i) => {
    const axis = i % 3
    low[axis] = Math.min(low[axis] ?? 0, value)
    high[axis] = Math.max(high[axis] ?? 0, value)
  })
  const bounds = { low: low as unknown as Vec3, high: high as unknown as Vec3 }
  knownBounds.set(positions, bounds)
  return bounds
}

/** Reflectance of the surface that the object stands on, by channel; 0 where it floats or lies tilted. */
export function groundReflectance(
  bounds: Bounds,
  radius: number,
  worldFromObject: ArrayLike<number>,
  room: Ground,
): Vec3 {
  const { low, high } = bounds
  const tilt = Math.min(1, Math.max(0, ((worldFromObject[5] ?? 0) - TILTED) / (UPRIGHT - TILTED)))
  if (tilt === 0) return [0, 0, 0]
  const reach = CONTACT_REACH * radius
  let sum: Vec3 = [0, 0, 0]
  for (const [x, z] of STARTS) {
    const base: Vec3 = [
      0.5 * (low[0] + high[0]) + 0.25 * (high[0] - low[0]) * x,
      low[1],
      0.5 * (low[2] + high[2]) + 0.25 * (high[2] - low[2]) * z,
    ]
    const origin = add(transformPoint(worldFromObject, base), [0, reach, 0])
    const hit = castRay(room, origin, [0, -1, 0], false, 2 * reach)
    if (!hit) continue
    const share = Math.max(0, 1 - Math.abs(hit.distance - reach) / reach)
    sum = add(sum, scale(vec3At(room.albedo, room.indices[3 * hit.triangle] ?? 0), share))
  }
  return scale(sum, tilt / STARTS.length)
}

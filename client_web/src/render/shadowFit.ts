/** Fits the shadow map of a VAL to the virtual objects: Rohmer et al. 2014, section 5. */
import { add, cross, dot, length, normalize, scale, subtract, type Vec3 } from './vector'

export interface Sphere {
  readonly centre: Vec3
  readonly radius: number
}

/** Axes (world) and window of one shadow map: place in the tile = slope * scale + offset. */
export interface ShadowFit {
  readonly right: Vec3
  readonly up: Vec3
  readonly axis: Vec3
  readonly scale: readonly [number, number]
  readonly offset: readonly [number, number]
  /** Distance along the axis before which no virtual object lies. */
  readonly nearestCaster: number
}

/** Metres. Nothing nearer to a VAL is drawn into its map. */
export const SHADOW_NEAR = 0.02
/** Half field of view of the map of a VAL that is too close to an object: 75 degrees. */
const WIDEST = (75 * Math.PI) / 180
/** Share of the window left free on each side, so that bilinear taps at silhouettes stay inside. */
const MARGIN = 0.03

/**
 * @param discRadius of the VAL; the window is widened by the penumbra beside the objects, where real surfaces need their own visibility.
 * @returns null when all objects lie behind the VAL.
 */
export function fitShadowMap(
  position: Vec3,
  normal: Vec3,
  discRadius: number,
  spheres: readonly Sphere[],
): ShadowFit | null {
  const lit = spheres.filter(
    (sphere) => dot(subtract(sphere.centre, position), normal) > -sphere.radius - discRadius,
  )
  if (lit.length === 0) {
    return null
  }
  const { axis, isWide } = chooseAxis(position, normal, lit)
  const hint: Vec3 = Math.abs(axis[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0]
  // right x up = -axis keeps the winding of triangles.
  const right = normalize(cross(axis, hint))
  const up = cross(right, axis)
  let nearestCaster = Number.POSITIVE_INFINITY
  const low: [number, number] = [Number.POSITIVE_INFINITY, Number.POSITIVE_INFINITY]
  const high: [number, number] = [Number.NEGATIVE_INFINITY, Number.NEGATIVE_INFINITY]
  for (const sphere of lit) {
    const offset = subtract(sphere.centre, position)
    const z = dot(offset, axis)
    nearestCaster = Math.min(nearestCaster, z - sphere.radius)
    const pad = isWide ? 0 : discRadius / Math.max(z, sphere.radius)
    ;[right, up].forEach((direction, i) => {
      const [from, to] = isWide
        ? [-Math.tan(WIDEST), Math.tan(WIDEST)]
        : slopeRange(dot(offset, direction), z, sphere.radius)
      low[i as 0 | 1] = Math.min(low[i as 0 | 1], from - pad)
      high[i as 0 | 1] = Math.max(high[i as 0 | 1], to + pad)
    })
  }
  const window = [0, 1].map((i) => {
    const size = (high[i as 0 | 1] - low[i as 0 | 1]) * (1 + 2 * MARGIN)
    const middle = 0.5 * (low[i as 0 | 1] + high[i as 0 | 1])
    return { scale: 1 / size, offset: 0.5 - middle / size }
  })
  const [x, y] = window as [{ scale: number; offset: number }, { scale: number; offset: number }]
  return {
    right,
    up,
    axis,
    scale: [x.scale, y.scale],
    offset: [x.offset, y.offset],
    nearestCaster: Math.max(nearestCaster, SHADOW_NEAR),
  }
}

function chooseAxis(
  position: Vec3,
  normal: Vec3,
  spheres: readonly Sphere[],
): { axis: Vec3; isWide: boolean } {
  let sum: Vec3 = [0, 0, 0]
  for (const sphere of spheres) {
    sum = add(sum, normalize(subtract(sphere.centre, position)))
  }
  const axis = normalize(sum)
  const fits = spheres.every((sphere) => {
    const offset = subtract(sphere.centre, position)
    const distance = length(offset)
    if (length(axis) === 0 || distance <= sphere.radius * 1.05) {
      return false
    }
    const angle = Math.acos(Math.min(1, Math.max(-1, dot(offset, axis) / distance)))
    return angle + Math.asin(sphere.radius / distance) < WIDEST
  })
  // Inside or beside an object no narrow window holds it: look along the normal with the widest one.
  return fits ? { axis, isWide: false } : { axis: normalize(add(scale(normal, 0.5), axis)), isWide: true }
}

/** Slopes of the two tangents to a circle at (x, z). */
function slopeRange(x: number, z: number, radius: number): [number, number] {
  const angle = Math.atan2(x, z)
  const half = Math.asin(Math.min(1, radius / Math.hypot(x, z)))
  const limit = (a: number): number => Math.tan(Math.min(WIDEST, Math.max(-WIDEST, a)))
  return [limit(angle - half), limit(angle + half)]
}

/** Two fits show the same map. */
export function sameFit(a: ShadowFit | null, b: ShadowFit | null): boolean {
  if (a === null || b === null) {
    return a === b
  }
  const flat = (fit: ShadowFit): number[] => [
    ...fit.right,
    ...fit.up,
    ...fit.axis,
    ...fit.scale,
    ...fit.offset,
    fit.nearestCaster,
  ]
  const values = flat(b)
  return flat(a).every((value, i) => value === values[i])
}

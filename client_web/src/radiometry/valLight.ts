/** Virtual area lights (VAL) as seen from points: the disc form of protocol/CONVENTIONS.md. */
import { addDirectional, type Vec3 } from './sh'

/** Floats per slot: position 3, area, normal 3, 0, radiant intensity 3, 0, four zeros. */
export const FLOATS_PER_VAL = 16
export const MAX_VALS = 64

/**
 * Irradiance on a surface that faces the VAL, with the direction to it.
 *
 * E = I max(0, n_val.-w) / (r^2 + A / pi): Rohmer et al. 2014, Eq. 6, with the disc term instead of the bare r^2.
 * Differs from the paper: the disc term, exact on the axis of a parallel diffuse disc, has no singularity.
 */
export function facingIrradiance(
  vals: ArrayLike<number>,
  slot: number,
  position: Vec3,
): { direction: Vec3; irradiance: Vec3 } {
  const base = slot * FLOATS_PER_VAL
  const at = (offset: number): number => vals[base + offset] ?? 0
  const toVal = [at(0) - position[0], at(1) - position[1], at(2) - position[2]] as const
  const squared = toVal[0] ** 2 + toVal[1] ** 2 + toVal[2] ** 2
  // As in the shaders and on the server: a point at the VAL's own place has no direction to it, and receives nothing.
  const scale = squared > 0 ? 1 / Math.sqrt(squared) : 0
  const direction: Vec3 = [toVal[0] * scale, toVal[1] * scale, toVal[2] * scale]
  const cosine = Math.max(0, -(at(4) * direction[0] + at(5) * direction[1] + at(6) * direction[2]))
  const denominator = squared + at(3) / Math.PI
  const factor = denominator > 0 ? cosine / denominator : 0
  return { direction, irradiance: [at(8) * factor, at(9) * factor, at(10) * factor] }
}

/**
 * The light of all VALs at a point as sh_coeffs (27), world axes: each VAL is one direction.
 *
 * @param visibility share of each VAL that is seen from there, by slot.
 */
export function projectVals(
  vals: ArrayLike<number>,
  count: number,
  position: Vec3,
  visibility: (slot: number) => number,
): Float32Array {
  const coeffs = new Float32Array(27)
  for (let slot = 0; slot < count; slot++) {
    const { direction, irradiance } = facingIrradiance(vals, slot, position)
    if (irradiance[0] > 0 || irradiance[1] > 0 || irradiance[2] > 0) {
      const seen = visibility(slot)
      if (seen > 0) {
        addDirectional(coeffs, direction, [irradiance[0] * seen, irradiance[1] * seen, irradiance[2] * seen])
      }
    }
  }
  return coeffs
}

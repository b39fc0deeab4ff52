/** VALs as the spot lights of other engines. Both engines get the same ones. */
import type { BenchLight, SpotVal } from './scene'

/** Texels per side, as many as ours draws for a live picture. */
export const SHADOW_MAP_SIZE = 128
/**
 * Spot lights stand in for VALs: a VAL shines over a hemisphere, which no shadow map of one picture can hold, so each spot aims at the
 * middle of the virtual objects with a cone that covers what lies around them.
 */
export const SPOT_HALF_ANGLE = (55 * Math.PI) / 180

/** The constant basis function. */
const Y0 = 0.5 / Math.sqrt(Math.PI)

/** W/sr towards the virtual objects: the cosine at the VAL is part of it. */
export function spotIntensity(
  val: SpotVal,
  target: readonly [number, number, number],
): [number, number, number] {
  const to = target.map((value, axis) => value - (val.position[axis] ?? 0))
  const distance = Math.max(Math.hypot(...to), 1e-6)
  const cosine = to.reduce((sum, value, axis) => sum + value * (val.normal[axis] ?? 0), 0) / distance
  const [r, g, b] = val.radiantIntensity
  // Lights that look away stay on, faintly: every engine pays for all of them.
  const share = Math.max(cosine, 1e-3)
  return [r * share, g * share, b * share]
}

/** Irradiance of the constant term of the objects' indirect light, W/m^2: pi times its mean radiance. */
export function meanAmbient(light: BenchLight): [number, number, number] {
  const objects = Math.max(1, light.objectSh.length / 27)
  const mean = (channel: number): number => {
    let sum = 0
    for (let object = 0; object < objects; object++) sum += light.objectSh[27 * object + channel] ?? 0
    return (Math.PI * Y0 * sum) / objects
  }
  return [mean(0), mean(1), mean(2)]
}

/**
 * How much of a VAL its own fixture leaves visible: lamp shades, window reveals, shelf edges.
 *
 * A blocker close to a light hides part of its disc from everywhere, with a penumbra wider than any shadow map can filter. Seen from an
 * object its effect is nearly constant, so a few rays per VAL and object find it. Blockers farther away are left to the shadow maps.
 */
import { FLOATS_PER_VAL } from '../radiometry/valLight'
import { castRay, type Triangles } from './rayMesh'
import { add, cross, dot, length, normalize, scale, subtract, type Vec3 } from './vector'

/** Blockers within this share of the way from the VAL to the nearest point of the object belong to the fixture. */
export const FIXTURE_SHARE = 0.25
const RAYS = 8
/** The disc of a square emitter has its corners' moments: only within this share of its radius is it sure to lie on the emitter. */
const SURE_RADIUS = Math.sqrt(3) / 2
const GOLDEN_ANGLE = Math.PI * (3 - Math.sqrt(5))
/** Metres that rays start in front of the emitter. */
const LIFT = 1e-3

export interface Disc {
  readonly position: Vec3
  readonly normal: Vec3
  readonly radius: number
}

/** Share of the disc from which `target` (centre and radius of an object) is not hidden by something close to the disc. */
export function fixtureVisibility(disc: Disc, target: Vec3, targetRadius: number, room: Triangles): number {
  const helper: Vec3 = Math.abs(disc.normal[0]) < 0.7 ? [1, 0, 0] : [0, 1, 0]
  const first = normalize(cross(disc.normal, helper))
  const second = cross(disc.normal, first)
  let open = 0
  for (let i = 0; i < RAYS; i++) {
    const r = SURE_RADIUS * disc.radius * Math.sqrt((i + 0.5) / RAYS)
    const angle = i * GOLDEN_ANGLE
    const offset = add(scale(first, r * Math.cos(angle)), scale(second, r * Math.sin(angle)))
    const start = add(add(disc.position, offset), scale(disc.normal, LIFT))
    const way = subtract(target, start)
    const distance = length(way)
    // What lies in the plane of the disc or behind it is not lit by it anyway.
    if (dot(way, disc.normal) <= 0 || distance <= targetRadius) {
      open++
      continue
    }
    const reach = (FIXTURE_SHARE * (distance - targetRadius)) / distance
    open += castRay(room, start, way, true, reach) === null ? 1 : 0
  }
  return open / RAYS
}

/** Whether something between fixture and object hides the middle of the VAL. */
export function isHiddenBeyondFixture(
  disc: Disc,
  target: Vec3,
  targetRadius: number,
  room: Triangles,
): boolean {
  const way = subtract(target, disc.position)
  const distance = length(way)
  if (distance <= targetRadius) return false
  const from = (FIXTURE_SHARE * (distance - targetRadius)) / distance
  const start = add(disc.position, scale(way, from))
  return castRay(room, start, scale(way, 1 - from), true, 1) !== null
}

/** The disc of a slot. */
export function discOf(vals: ArrayLike<number>, slot: number): Disc {
  const at = (offset: number): number => vals[slot * FLOATS_PER_VAL + offset] ?? 0
  return {
    position: [at(0), at(1), at(2)],
    normal: [at(4), at(5), at(6)],
    radius: Math.sqrt(at(3) / Math.PI),
  }
}

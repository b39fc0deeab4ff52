/** Per-object light: sh_coeffs in object axes, with and without the VALs. */
import { rotateSh } from '../radiometry/sh'
import { FLOATS_PER_VAL, projectVals } from '../radiometry/valLight'
import { boundsOf, groundContact } from './groundContact'
import { type ObjectState, worldCentre } from './objectData'
import { castRay, type Triangles } from './rayMesh'
import type { ObjectAsset } from './types'
import { subtract } from './vector'

/** Above this number of room triangles the rays would cost a frame; VALs then count as seen (too bright in their shadow). */
const MAX_RAY_TRIANGLES = 20_000
/** Share of the way left free at the VAL, which lies on a surface of the room itself. */
const CLEARANCE = 1e-3

export interface LightInput {
  readonly vals: ArrayLike<number>
  readonly count: number
  /** 27 per object, world axes. */
  readonly objectSh: ArrayLike<number>
}

export function lightObject(
  asset: ObjectAsset,
  index: number,
  worldFromObject: Float32Array,
  light: LightInput,
  room: Triangles,
): ObjectState {
  const m = worldFromObject
  const worldFromObjectRows = [0, 4, 8, 1, 5, 9, 2, 6, 10].map((i) => m[i] ?? 0)
  const indirect = Array.from({ length: 27 }, (_, i) => light.objectSh[27 * index + i] ?? 0)
  const centre = worldCentre({ asset, worldFromObject })
  const useRays = room.indices.length <= 3 * MAX_RAY_TRIANGLES
  const fromVals = projectVals(light.vals, light.count, centre, (slot) => {
    if (!useRays) return 1
    const base = slot * FLOATS_PER_VAL
    const position = [0, 1, 2].map((i) => light.vals[base + i] ?? 0) as [number, number, number]
    const hit = castRay(room, position, subtract(centre, position), true, 1)
    return hit !== null && hit.distance > CLEARANCE ? 0 : 1
  })
  const all = indirect.map((value, i) => value + (fromVals[i] ?? 0))
  return {
    asset,
    worldFromObject,
    contact: groundContact(boundsOf(asset.positions), asset.radius, worldFromObject, room),
    shIndirect: rotateSh(indirect, worldFromObjectRows),
    shAll: rotateSh(all, worldFromObjectRows),
  }
}

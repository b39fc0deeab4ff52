/** Per-object light: sh_coeffs in object axes, with and without the VALs. */
import { rotateSh } from '../radiometry/sh'
import { MAX_VALS, projectVals } from '../radiometry/valLight'
import { discOf, fixtureVisibility, isHiddenBeyondFixture } from './fixtureVisibility'
import { boundsOf, type Ground, groundReflectance } from './groundContact'
import { type ObjectState, worldCentre } from './objectData'
import type { ObjectAsset } from './types'

/** Above this number of room triangles the rays would cost a frame; VALs then count as seen (too bright in their shadow). */
const MAX_RAY_TRIANGLES = 20_000

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
  room: Ground,
): ObjectState {
  const m = worldFromObject
  const worldFromObjectRows = [0, 4, 8, 1, 5, 9, 2, 6, 10].map((i) => m[i] ?? 0)
  const indirect = Array.from({ length: 27 }, (_, i) => light.objectSh[27 * index + i] ?? 0)
  const centre = worldCentre({ asset, worldFromObject })
  const useRays = room.indices.length <= 3 * MAX_RAY_TRIANGLES
  const openShare = new Float32Array(MAX_VALS).fill(1)
  const fromVals = projectVals(light.vals, light.count, centre, (slot) => {
    if (!useRays) return 1
    const disc = discOf(light.vals, slot)
    const open = fixtureVisibility(disc, centre, asset.radius, room)
    openShare[slot] = open
    return open > 0 && isHiddenBeyondFixture(disc, centre, asset.radius, room) ? 0 : open
  })
  const all = indirect.map((value, i) => value + (fromVals[i] ?? 0))
  return {
    asset,
    worldFromObject,
    groundReflectance: groundReflectance(boundsOf(asset.positions), asset.radius, worldFromObject, room),
    openShare,
    shIndirect: rotateSh(indirect, worldFromObjectRows),
    shAll: rotateSh(all, worldFromObjectRows),
  }
}

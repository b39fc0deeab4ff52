import { describe, expect, it } from 'vitest'
import { centredLens } from './camera'
import { boundsOf, groundReflectance } from './groundContact'
import { pickSurface } from './pick'
import { castRay } from './rayMesh'

/** The square [-2, 2]^2 at y = 0, facing up. */
const floor = {
  positions: Float32Array.of(-2, 0, -2, -2, 0, 2, 2, 0, 2, 2, 0, -2),
  indices: Uint32Array.of(0, 1, 2, 0, 2, 3),
}
/** A table top of half a metre at height 0 of its own axes. */
const plate = {
  positions: floor.positions.map((v) => v / 8),
  indices: floor.indices,
}
/** Camera at (0, 3, 0) that looks down; picture up is world -z. */
const lookingDown = Float32Array.of(1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 3, 0, 1)
const lens = centredLens(100, 100, Math.PI / 2)
const lifted = Float32Array.of(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0.5, 0, 1)

describe('castRay', () => {
  it('sees one-sided surfaces from the front only', () => {
    expect(castRay(floor, [0.3, 1, 0.4], [0, -2, 0], true)?.distance).toBeCloseTo(0.5, 9)
    expect(castRay(floor, [0.3, -1, 0.4], [0, 2, 0], true)).toBeNull()
    expect(castRay(floor, [0.3, -1, 0.4], [0, 2, 0], false)?.distance).toBeCloseTo(0.5, 9)
    expect(castRay(floor, [0.3, 1, 0.4], [0, -2, 0], true, 0.4)).toBeNull()
  })
})

describe('pickSurface', () => {
  const scene = { room: floor, objects: [{ mesh: plate, worldFromObject: lifted }] }

  it('finds the object in front of the room', () => {
    const hit = pickSurface(scene, lens, lookingDown, 0, 0)
    expect(hit?.objectIndex).toBe(0)
    expect(hit?.positionWorld[1]).toBeCloseTo(0.5, 6)
    expect(hit?.normalWorld[1]).toBeCloseTo(1, 6)
  })

  it('finds the room beside it, at the place that the picture shows', () => {
    const hit = pickSurface(scene, lens, lookingDown, 0.5, 0.25)
    expect(hit?.objectIndex).toBe(-1)
    expect(hit?.positionWorld[0]).toBeCloseTo(1.5, 6)
    expect(hit?.positionWorld[1]).toBeCloseTo(0, 6)
    expect(hit?.positionWorld[2]).toBeCloseTo(-0.75, 6)
  })

  it('finds nothing past the edge', () => {
    expect(pickSurface(scene, lens, lookingDown, 0.9, 0)).toBeNull()
  })
})

describe('groundReflectance', () => {
  const bounds = boundsOf(plate.positions)
  const albedo = [0.6, 0.4, 0.2] as const
  const ground = { ...floor, albedo: Float32Array.from({ length: 12 }, (_, i) => albedo[i % 3] ?? 0) }
  const at = (height: number): Float32Array => {
    const pose = lifted.slice()
    pose[13] = height
    return pose
  }
  const expectShare = (pose: Float32Array, share: number): void => {
    groundReflectance(bounds, 1, pose, ground).forEach((value, i) => {
      expect(value).toBeCloseTo(share * (albedo[i] ?? 0), 5)
    })
  }

  it('is that of the floor on it, half at half the reach, none above or when tilted', () => {
    expectShare(at(0), 1)
    expectShare(at(0.1), 0.5)
    expectShare(at(0.3), 0)
    const tilted = at(0)
    tilted[5] = 0.8
    expectShare(tilted, 0)
  })

  it('counts only the part that stands on the floor', () => {
    const overEdge = at(0)
    overEdge[12] = 2
    expectShare(overEdge, 0.6)
  })
})

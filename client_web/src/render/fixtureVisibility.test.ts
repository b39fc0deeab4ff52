import { describe, expect, it } from 'vitest'
import { type Disc, fixtureVisibility, isHiddenBeyondFixture } from './fixtureVisibility'
import type { Triangles } from './rayMesh'

/** A lamp at the ceiling that shines down. */
const LAMP: Disc = { position: [0, 3, 0], normal: [0, -1, 0], radius: 0.1 }
const BELOW = [0, 1, 0] as const

/** Horizontal rectangle seen from above as well as from below. */
function plate(x0: number, x1: number, y: number, halfDepth = 1): Triangles {
  const corners = [
    [x0, y, -halfDepth],
    [x1, y, -halfDepth],
    [x1, y, halfDepth],
    [x0, y, halfDepth],
  ]
  return {
    positions: Float32Array.from(corners.flat()),
    indices: Uint32Array.from([0, 1, 2, 0, 2, 3, 0, 2, 1, 0, 3, 2]),
  }
}

describe('fixture visibility', () => {
  it('is whole without blockers, and nothing under a closed shade', () => {
    expect(fixtureVisibility(LAMP, [...BELOW], 0.2, plate(5, 6, 2))).toBe(1)
    expect(fixtureVisibility(LAMP, [...BELOW], 0.2, plate(-1, 1, 2.95))).toBe(0)
  })

  it('is about half where an edge close to the lamp cuts its disc in two', () => {
    expect(fixtureVisibility(LAMP, [...BELOW], 0.2, plate(-1, 0, 2.99))).toBeCloseTo(0.5, 0)
    expect(fixtureVisibility(LAMP, [...BELOW], 0.2, plate(-1, 0, 2.99))).toBeGreaterThan(0.25)
    expect(fixtureVisibility(LAMP, [...BELOW], 0.2, plate(-1, 0, 2.99))).toBeLessThan(0.75)
  })

  it('leaves blockers beyond a quarter of the way to the shadow maps', () => {
    const table = plate(-1, 1, 2)
    expect(fixtureVisibility(LAMP, [...BELOW], 0.2, table)).toBe(1)
    expect(isHiddenBeyondFixture(LAMP, [...BELOW], 0.2, table)).toBe(true)
    expect(isHiddenBeyondFixture(LAMP, [...BELOW], 0.2, plate(-1, 1, 2.95))).toBe(false)
  })

  it('counts every blocker once: those of the fixture and those beyond it share the whole way', () => {
    for (let y = 2.98; y > 1.25; y -= 0.05) {
      const blocked = fixtureVisibility(LAMP, [...BELOW], 0.2, plate(-3, 3, y, 3)) < 1
      expect(blocked !== isHiddenBeyondFixture(LAMP, [...BELOW], 0.2, plate(-3, 3, y, 3)), `at ${y}`).toBe(
        true,
      )
    }
  })

  it('hides nothing from an object that the lamp touches', () => {
    expect(fixtureVisibility(LAMP, [0, 2.9, 0], 0.2, plate(-1, 1, 2.95))).toBe(1)
  })
})

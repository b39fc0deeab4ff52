import fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import { evaluateSh, irradianceFromSh } from './sh'
import { FLOATS_PER_VAL, facingIrradiance, projectVals } from './valLight'

/** A disc of radiance 5 and radius 0.3 that looks down from (0, 2, 0). */
const RADIUS = 0.3
const AREA = Math.PI * RADIUS ** 2
const disc = Float32Array.of(0, 2, 0, AREA, 0, -1, 0, 0, 5 * AREA, 5 * AREA, 5 * AREA, 0, 0, 0, 0, 0)

describe('facing irradiance', () => {
  it('equals the closed form on the axis of a parallel disc, however near', () => {
    for (const height of [0.01, 0.1, 1, 10]) {
      const { irradiance } = facingIrradiance(disc, 0, [0, 2 - height, 0])
      const exact = (Math.PI * 5 * RADIUS ** 2) / (RADIUS ** 2 + height ** 2)
      expect(irradiance[0] / exact).toBeCloseTo(1, 6)
    }
  })

  it('is zero behind the disc', () => {
    expect(facingIrradiance(disc, 0, [0.4, 2.5, 0]).irradiance).toEqual([0, 0, 0])
  })

  it('is zero at the place of the VAL itself, also of one without area', () => {
    for (const area of [AREA, 0]) {
      const val = disc.slice()
      val[3] = area
      expect(facingIrradiance(val, 0, [0, 2, 0]).irradiance).toEqual([0, 0, 0])
      expect([...projectVals(val, 1, [0, 2, 0], () => 1)]).toEqual(new Array(27).fill(0))
    }
  })

  it('never exceeds that of a hemisphere of the same radiance, however near and however small', () => {
    // Squares of smaller numbers leave the range of doubles.
    const offset = fc.double({ min: -1, max: 1, noNaN: true }).map((x) => (Math.abs(x) < 1e-100 ? 0 : x))
    const decade = fc.double({ min: -12, max: 3, noNaN: true })
    fc.assert(
      fc.property(offset, offset, offset, decade, decade, (x, y, z, distance, size) => {
        const [scale, area] = [10 ** distance, 10 ** size]
        const val = Float64Array.of(0, 2, 0, area, 0, -1, 0, 0, 5 * area, 0, 0, 0, 0, 0, 0, 0)
        const { direction, irradiance } = facingIrradiance(val, 0, [scale * x, 2 + scale * y, scale * z])
        expect(irradiance[0]).toBeGreaterThanOrEqual(0)
        expect(irradiance[0]).toBeLessThanOrEqual(5 * Math.PI * (1 + 1e-12))
        const length = Math.hypot(...direction)
        expect(length === 0 || Math.abs(length - 1) < 1e-9).toBe(true)
      }),
    )
  })
})

describe('projection', () => {
  it('keeps the mean over all directions and points to the light', () => {
    const sh = projectVals(disc, 1, [0, 1, 0], () => 1)
    const { irradiance } = facingIrradiance(disc, 0, [0, 1, 0])
    expect((sh[0] ?? 0) * Math.sqrt(4 * Math.PI)).toBeCloseTo(irradiance[0], 6)
    expect(irradianceFromSh(sh, [0, 1, 0])[0]).toBeGreaterThan(irradianceFromSh(sh, [0, -1, 0])[0])
    expect(evaluateSh(sh, [0, 1, 0])[0]).toBeGreaterThan(0)
  })

  it('scales with visibility and adds up', () => {
    const two = new Float32Array(2 * FLOATS_PER_VAL)
    two.set(disc)
    two.set(disc, FLOATS_PER_VAL)
    const one = projectVals(disc, 1, [0.2, 0.5, 0.1], () => 1)
    const half = projectVals(two, 2, [0.2, 0.5, 0.1], () => 0.5)
    half.forEach((value, i) => {
      expect(value).toBeCloseTo(one[i] ?? 0, 6)
    })
  })
})

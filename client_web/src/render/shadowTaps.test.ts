import { describe, expect, it } from 'vitest'
import { makeTaps } from './shadowTaps'

const { search, filter, numFilter, numSearch } = makeTaps(48, 96)
const points = (values: Float32Array, stride: number): number[][] =>
  Array.from({ length: values.length / stride }, (_, i) => [...values.subarray(stride * i, stride * (i + 1))])

describe('makeTaps', () => {
  it('keeps every tap in the unit disc', () => {
    for (const [x = 0, y = 0] of [...points(search, 4), ...points(filter, 2)]) {
      expect(Math.hypot(x, y)).toBeLessThan(1)
    }
    expect(search.length).toBe(4 * numSearch)
    expect(filter.length).toBe(2 * numFilter)
  })

  it('spreads the filter evenly: centre and second moment of the disc', () => {
    const mean = (f: (x: number, y: number) => number): number =>
      points(filter, 2).reduce((sum, [x = 0, y = 0]) => sum + f(x, y), 0) / numFilter
    expect(mean((x) => x)).toBeCloseTo(0, 1)
    expect(mean((_, y) => y)).toBeCloseTo(0, 1)
    expect(mean((x, y) => x * x + y * y)).toBeCloseTo(0.5, 5)
  })

  it('weighs the search by the area that a tap stands for', () => {
    const taps = points(search, 4)
    const total = taps.reduce((sum, [, , share = 0]) => sum + share, 0)
    // Mean squared radius of an even disc.
    const second = taps.reduce((sum, [, , share = 0, r = 0]) => sum + share * r * r, 0) / total
    expect(second).toBeCloseTo(0.5, 1)
    for (const [x = 0, y = 0, , r = 0] of taps) expect(Math.hypot(x, y)).toBeCloseTo(r, 6)
  })
})

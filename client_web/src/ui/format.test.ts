import { describe, expect, it } from 'vitest'
import {
  bytes,
  duration,
  encodeSrgb,
  lampColour,
  milliseconds,
  perSecond,
  readableName,
  share,
  stops,
  withAge,
} from './format'

describe('format', () => {
  it('shows the hue of a lamp, not its strength', () => {
    expect(lampColour([15, 15, 15])).toBe('rgb(255, 255, 255)')
    expect(lampColour([300, 0, 0])).toBe('rgb(255, 0, 0)')
    expect(lampColour([2, 1, 0])).toBe('rgb(255, 188, 0)')
    expect(lampColour([0, 0, 0])).toBe('rgb(70, 70, 70)')
  })

  it('follows the sRGB standard at its joint and ends', () => {
    expect(encodeSrgb(0)).toBe(0)
    expect(encodeSrgb(1)).toBeCloseTo(1, 12)
    expect(encodeSrgb(0.0031308)).toBeCloseTo(encodeSrgb(0.0031309), 5)
  })

  it('tells the age only once it can be felt', () => {
    expect(withAge('Live', null)).toBe('Live')
    expect(withAge('Live', 499)).toBe('Live')
    expect(withAge('Live', 620)).toBe('Live · 620 ms')
  })

  it('reads well', () => {
    expect(milliseconds(41.6)).toBe('42 ms')
    expect(milliseconds(65_000)).toBe('65 s')
    expect(milliseconds(null)).toBe('–')
    expect(milliseconds(Number.POSITIVE_INFINITY)).toBe('–')
    expect(bytes(620)).toBe('620 B')
    expect(bytes(14_200)).toBe('14.2 kB')
    expect(perSecond(18.55)).toBe('19 /s')
    expect(perSecond(2.04)).toBe('2.0 /s')
    expect(stops(2)).toBe('+1.0')
    expect(stops(0.5)).toBe('−1.0')
    expect(stops(1.01)).toBe('0.0')
    expect(readableName('ceiling_light')).toBe('Ceiling light')
  })

  it('adds time up in units that stay readable', () => {
    expect([0, 0.31, 38.4, 950].map(duration)).toEqual(['0 ms', '0.3 ms', '38 ms', '950 ms'])
    expect([1000, 59_000, 90_000].map(duration)).toEqual(['1.0 s', '59 s', '1.5 min'])
    expect([7_200_000, 36 * 3_600_000].map(duration)).toEqual(['2.0 h', '1.5 d'])
  })

  it('never rounds a little to nothing or almost all to all', () => {
    expect([0, 1e-6, 0.0204, 0.5, 0.9999, 1].map(share)).toEqual([
      '0 %',
      '0.1 %',
      '2.0 %',
      '50 %',
      '99 %',
      '100 %',
    ])
  })
})

import * as fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import {
  decodeArea,
  decodeHalf,
  decodeNormal,
  decodeRgb9e5,
  encodeArea,
  encodeHalf,
  encodeNormal,
  encodeRgb9e5,
  halfScaleExponent,
  isNormalWord,
  rgb9e5ScaleExponent,
  scaleByPowerOfTwo,
} from './quantise'

const channel = fc.double({ min: 0, max: 2 ** 120, noNaN: true, noDefaultInfinity: true })

describe('half floats', () => {
  it('all finite ones survive', () => {
    const changed: number[] = []
    for (let bits = 0; bits < 65536; bits++) {
      const value = decodeHalf(bits)
      if (Number.isFinite(value) && encodeHalf(value) !== bits) changed.push(bits)
    }
    expect(changed).toEqual([])
  })
  it('are the nearest, ties to even', () => {
    expect(decodeHalf(encodeHalf(2049))).toBe(2048)
    expect(decodeHalf(encodeHalf(2051))).toBe(2052)
    expect(decodeHalf(encodeHalf(65504))).toBe(65504)
    expect(decodeHalf(encodeHalf(2 ** -25))).toBe(0)
    expect(decodeHalf(0x7c00)).toBe(Number.POSITIVE_INFINITY)
    expect(decodeHalf(0x7c01)).toBeNaN()
  })
  it('err by 2^-11 at most once scaled', () => {
    fc.assert(
      fc.property(fc.double({ min: 2 ** -100, max: 2 ** 100, noNaN: true }), (value) => {
        const exponent = halfScaleExponent(value)
        const found = scaleByPowerOfTwo(decodeHalf(encodeHalf(scaleByPowerOfTwo(value, -exponent))), exponent)
        expect(Math.abs(found - value)).toBeLessThanOrEqual(value * 2 ** -11)
      }),
    )
  })
})

describe('shared exponents', () => {
  it('err by 0.1955 % of the largest channel at most', () => {
    fc.assert(
      fc.property(fc.tuple(channel, channel, channel), (rgb) => {
        const largest = Math.max(...rgb)
        const exponent = rgb9e5ScaleExponent(largest)
        const out = new Float32Array(3)
        decodeRgb9e5(encodeRgb9e5(...rgb, exponent), exponent, out, 0)
        // 2^-149: the smallest float32 is the smallest step.
        const bound = Math.max(largest / 511.5, 2 ** -149)
        for (let c = 0; c < 3; c++) {
          expect(Math.abs((out[c] as number) - (rgb[c] as number))).toBeLessThanOrEqual(bound)
        }
      }),
    )
  })
  it('saturate without a scale', () => {
    const out = new Float32Array(3)
    decodeRgb9e5(encodeRgb9e5(1e6, 65504, 0), 0, out, 0)
    expect(Array.from(out)).toEqual([65408, 65408, 0])
  })
})

describe('areas', () => {
  it('all codes survive, in ascending order', () => {
    const wrong: number[] = []
    let previous = -1
    for (let code = 0; code < 65536; code++) {
      const area = decodeArea(code)
      if (!(area > previous) || encodeArea(area) !== code) wrong.push(code)
      previous = area
    }
    expect(wrong).toEqual([])
  })
})

describe('normals', () => {
  it('err by sqrt(18) / 4094 rad at most, and stay the same word', () => {
    const out = new Float32Array(3)
    const changed: number[] = []
    let worst = 0
    for (let i = 0; i < 50_000; i++) {
      const z = 1 - (2 * (i + 0.5)) / 50_000
      const phi = Math.PI * (1 + Math.sqrt(5)) * i
      const r = Math.sqrt(1 - z * z)
      const normal: [number, number, number] = [r * Math.cos(phi), r * Math.sin(phi), z]
      const word = encodeNormal(...normal, i & 255)
      decodeNormal(word, out, 0)
      const [x, y, w] = out as unknown as [number, number, number]
      const chord = Math.hypot(x - normal[0], y - normal[1], w - normal[2])
      worst = Math.max(worst, 2 * Math.asin(chord / 2))
      if (encodeNormal(x, y, w, i & 255) !== word) changed.push(word)
    }
    expect(changed).toEqual([])
    expect(worst).toBeLessThanOrEqual(Math.sqrt(18) / 4094 + 2e-7)
  })
  it('are exact on the axes', () => {
    const out = new Float32Array(3)
    for (const axis of [0, 1, 2]) {
      for (const sign of [-1, 1]) {
        const normal: [number, number, number] = [0, 0, 0]
        normal[axis] = sign
        const word = encodeNormal(...normal, 255)
        decodeNormal(word, out, 0)
        expect(Array.from(out, (value) => value + 0)).toEqual(normal)
        expect(word >>> 24).toBe(255)
      }
    }
  })
  it('have no coordinate 4095', () => {
    expect(isNormalWord(0xfff)).toBe(false)
    expect(isNormalWord(0xfff000)).toBe(false)
    expect(isNormalWord(encodeNormal(0, 0, -1, 255))).toBe(true)
  })
})

// Numbers in few bits; the same rules as protocol/nearfield_protocol/quantise.py, bit for bit. Error bounds: protocol/SPEC.md.

import { AREA_EXPONENT_BIAS, NORMAL_STEPS, RGB9E5_EXPONENT_BIAS } from './layout.gen'

/** Largest magnitude of a radiant intensity or SH coefficient. */
export const MAX_RADIOMETRIC = 2 ** 126
/** Bounds and poses reach no further than this, metres. */
export const MAX_COORDINATE = 2 ** 20
export const MIN_SCALE_EXPONENT_RGB = -149 + RGB9E5_EXPONENT_BIAS + 9
export const MIN_SCALE_EXPONENT_HALF = -149 + 24
/** Largest area that a compact VAL can hold, m^2. */
export const AREA_MAX = 2047 * 2 ** (63 - AREA_EXPONENT_BIAS - 10)

const scratch = new DataView(new ArrayBuffer(8))

/** Exponent e with value in [2^e, 2^(e + 1)), exact; -1100 for zero. The value is at least the smallest float32. */
function exponentOf(value: number): number {
  if (value === 0) return -1100
  scratch.setFloat64(0, value)
  return ((scratch.getUint16(0) >> 4) & 0x7ff) - 1023
}

/** The same for the value rounded to so many significant bits. */
function exponentOfRounded(value: number, bits: number): number {
  const exponent = exponentOf(value)
  return value > 0 && Math.round(value * 2 ** (bits - 1 - exponent)) >= 2 ** bits ? exponent + 1 : exponent
}

/** `value * 2^exponent` without overflow of the power itself. */
export function scaleByPowerOfTwo(value: number, exponent: number): number {
  const half = Math.trunc(exponent / 2)
  return value * 2 ** half * 2 ** (exponent - half)
}

/** Pack a unit normal and the generation of its slot: octahedral map in 2 x 12 bit. */
export function encodeNormal(nx: number, ny: number, nz: number, generation: number): number {
  const sum = Math.abs(nx) + Math.abs(ny) + Math.abs(nz)
  const x = nx / sum
  const y = ny / sum
  const lower = nz / sum < 0
  let u = Math.round((lower ? (1 - Math.abs(y)) * (x < 0 ? -1 : 1) : x) * NORMAL_STEPS)
  let v = Math.round((lower ? (1 - Math.abs(x)) * (y < 0 ? -1 : 1) : y) * NORMAL_STEPS)
  // Opposite points of the square's rim are the same direction: one of them is the canonical word.
  const onRimU = Math.abs(u) === NORMAL_STEPS
  if (Math.abs(v) === NORMAL_STEPS) u = Math.abs(u)
  if (onRimU) v = Math.abs(v)
  return ((u + NORMAL_STEPS) | ((v + NORMAL_STEPS) << 12) | (generation << 24)) >>> 0
}

/** Whether a word holds a normal: the coordinate 4095 is written by no encoder. */
export function isNormalWord(word: number): boolean {
  return (word & 0xfff) !== 0xfff && ((word >>> 12) & 0xfff) !== 0xfff
}

/** Undo `encodeNormal` into out[offset..offset + 2]; the generation is `word >>> 24`. */
export function decodeNormal(word: number, out: Float32Array, offset: number): void {
  let x = ((word & 0xfff) - NORMAL_STEPS) / NORMAL_STEPS
  let y = (((word >>> 12) & 0xfff) - NORMAL_STEPS) / NORMAL_STEPS
  const z = 1 - Math.abs(x) - Math.abs(y)
  const fold = Math.max(-z, 0)
  x -= x < 0 ? -fold : fold
  y -= y < 0 ? -fold : fold
  const length = Math.sqrt(x * x + y * y + z * z)
  out[offset] = x / length
  out[offset + 1] = y / length
  out[offset + 2] = z / length
}

/** Scale exponent that puts the largest channel at the top of the shared exponent's range. */
export function rgb9e5ScaleExponent(largest: number): number {
  if (largest === 0) return 0
  return Math.max(exponentOfRounded(largest, 9) - (31 - RGB9E5_EXPONENT_BIAS) + 1, MIN_SCALE_EXPONENT_RGB)
}

/** Pack RGB, finite and >= 0, into an RGB9_E5 word; saturates at 65408 * 2^scaleExponent. */
export function encodeRgb9e5(red: number, green: number, blue: number, scaleExponent = 0): number {
  const r = Math.min(scaleByPowerOfTwo(red, -scaleExponent), 65408)
  const g = Math.min(scaleByPowerOfTwo(green, -scaleExponent), 65408)
  const b = Math.min(scaleByPowerOfTwo(blue, -scaleExponent), 65408)
  const exponent = Math.max(exponentOfRounded(Math.max(r, g, b), 9) + RGB9E5_EXPONENT_BIAS + 1, 0)
  const step = 2 ** (24 - exponent)
  return (
    (Math.round(r * step) | (Math.round(g * step) << 9) | (Math.round(b * step) << 18) | (exponent << 27)) >>>
    0
  )
}

/** Undo `encodeRgb9e5`, exactly, into out[offset..offset + 2]. */
export function decodeRgb9e5(word: number, scaleExponent: number, out: Float32Array, offset: number): void {
  const exponent = (word >>> 27) - 24 + scaleExponent
  out[offset] = scaleByPowerOfTwo(word & 0x1ff, exponent)
  out[offset + 1] = scaleByPowerOfTwo((word >>> 9) & 0x1ff, exponent)
  out[offset + 2] = scaleByPowerOfTwo((word >>> 18) & 0x1ff, exponent)
}

/** Area, 0 <= area <= AREA_MAX, as an unsigned float of 6 + 10 bits. */
export function encodeArea(area: number): number {
  const exponent = Math.max(exponentOfRounded(area, 11) + AREA_EXPONENT_BIAS, 1)
  const mantissa = Math.round(scaleByPowerOfTwo(area, AREA_EXPONENT_BIAS + 10 - exponent))
  return Math.min(mantissa + ((exponent - 1) << 10), 0xffff)
}

/** Undo `encodeArea`, exactly. */
export function decodeArea(code: number): number {
  const exponent = Math.max(code >> 10, 1)
  return (code - ((exponent - 1) << 10)) * 2 ** (exponent - AREA_EXPONENT_BIAS - 10)
}

/** Scale exponent that puts the largest magnitude into [2^14, 2^15) of a half float. */
export function halfScaleExponent(largest: number): number {
  return largest === 0 ? 0 : Math.max(exponentOfRounded(largest, 11) - 14, MIN_SCALE_EXPONENT_HALF)
}

function roundHalfToEven(value: number): number {
  const floor = Math.floor(value)
  const rest = value - floor
  if (rest !== 0.5) return rest < 0.5 ? floor : floor + 1
  return floor % 2 === 0 ? floor : floor + 1
}

/** The bits of the half float nearest to a finite value of magnitude <= 65504 (ties to even). */
export function encodeHalf(value: number): number {
  const magnitude = Math.abs(value)
  const sign = value < 0 || Object.is(value, -0) ? 0x8000 : 0
  const exponent = Math.max(exponentOf(magnitude), -14)
  // The mantissa carries into the exponent field by itself.
  return sign | (roundHalfToEven(magnitude * 2 ** (10 - exponent)) + ((exponent + 14) << 10))
}

/** The value of a half float's bits. */
export function decodeHalf(bits: number): number {
  const exponent = (bits >> 10) & 0x1f
  const mantissa = bits & 0x3ff
  const sign = bits & 0x8000 ? -1 : 1
  if (exponent === 31) return mantissa ? Number.NaN : sign * Number.POSITIVE_INFINITY
  return sign * (exponent === 0 ? mantissa * 2 ** -24 : (1024 + mantissa) * 2 ** (exponent - 25))
}

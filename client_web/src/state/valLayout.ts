/** How a virtual area light lies in memory, and how two of them are mixed. */

/** Floats per slot: position 3, area, normal 3, 0, radiant intensity 3, 0, 0 0 0 0. */
export const FLOATS_PER_VAL = 16
const AREA = 3
export const NORMAL = 4
export const INTENSITY = 8

/** Writes the state between two lights (in the same slot of two arrays); both ends of the fade are exact. */
export function mixVal(
  from: Float32Array,
  to: Float32Array,
  base: number,
  amount: number,
  out: Float32Array,
): void {
  for (let i = 0; i < FLOATS_PER_VAL; i++) {
    out[i] = mix(at(from, base + i), at(to, base + i), amount)
  }
  if (amount <= 0 || amount >= 1 || sameNormal(from, to, base)) {
    return
  }
  const length = Math.hypot(at(out, NORMAL), at(out, NORMAL + 1), at(out, NORMAL + 2))
  for (let axis = 0; axis < 3; axis++) {
    // Opposite normals have no direction between them.
    out[NORMAL + axis] = length < 1e-3 ? at(to, base + NORMAL + axis) : at(out, NORMAL + axis) / length
  }
}

export function at(values: Float32Array | Int16Array | Uint8Array, index: number): number {
  return values[index] as number
}

export function mix(from: number, to: number, amount: number): number {
  if (amount <= 0) {
    return from
  }
  return amount >= 1 ? to : (1 - amount) * from + amount * to
}

export function isLit(values: Float32Array, offset: number): boolean {
  return values[offset] !== 0 || values[offset + 1] !== 0 || values[offset + 2] !== 0
}

function sameNormal(from: Float32Array, to: Float32Array, base: number): boolean {
  return (
    from[base + NORMAL] === to[base + NORMAL] &&
    from[base + NORMAL + 1] === to[base + NORMAL + 1] &&
    from[base + NORMAL + 2] === to[base + NORMAL + 2]
  )
}

export function copyPlace(source: Float32Array, target: Float32Array, base: number): void {
  for (let i = 0; i < INTENSITY; i++) {
    target[base + i] = at(source, base + i)
  }
}

/** Largest deviation of position, normal and disc radius between a light and slot `base` of an array. */
export function placeDistance(light: Float32Array, others: Float32Array, base: number): number {
  let largest = Math.abs(Math.sqrt(at(light, AREA) / Math.PI) - Math.sqrt(at(others, base + AREA) / Math.PI))
  for (let axis = 0; axis < 3; axis++) {
    const position = Math.abs(at(light, axis) - at(others, base + axis))
    const normal = Math.abs(at(light, NORMAL + axis) - at(others, base + NORMAL + axis))
    largest = Math.max(largest, position, normal)
  }
  return largest
}

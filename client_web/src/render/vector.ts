/** The few vector operations of the renderer's own mathematics; plain tuples, no allocation tricks. */
export type Vec3 = readonly [number, number, number]

export const add = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
export const subtract = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
export const scale = (a: Vec3, factor: number): Vec3 => [a[0] * factor, a[1] * factor, a[2] * factor]
export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
export const length = (a: Vec3): number => Math.hypot(a[0], a[1], a[2])
export const cross = (a: Vec3, b: Vec3): Vec3 => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
]

/** Unit vector; the zero vector stays zero. */
export function normalize(a: Vec3): Vec3 {
  const size = length(a)
  return size > 0 ? scale(a, 1 / size) : a
}

/** Vector 3 at an index of a packed array. */
export function vec3At(values: ArrayLike<number>, index: number): Vec3 {
  return [values[3 * index] ?? 0, values[3 * index + 1] ?? 0, values[3 * index + 2] ?? 0]
}

/** Column-major 4x4 times point (w = 1). */
export function transformPoint(m: ArrayLike<number>, p: Vec3): Vec3 {
  const row = (i: number): number =>
    (m[i] ?? 0) * p[0] + (m[4 + i] ?? 0) * p[1] + (m[8 + i] ?? 0) * p[2] + (m[12 + i] ?? 0)
  return [row(0), row(1), row(2)]
}

/** Column-major 4x4 product. */
export function multiply4(a: ArrayLike<number>, b: ArrayLike<number>): Float32Array {
  const result = new Float32Array(16)
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      let sum = 0
      for (let k = 0; k < 4; k++) {
        sum += (a[4 * k + row] ?? 0) * (b[4 * column + k] ?? 0)
      }
      result[4 * column + row] = sum
    }
  }
  return result
}

/** Inverse of a rotation with translation, column-major. */
export function invertRigid(m: ArrayLike<number>): Float32Array {
  const at = (i: number): number => m[i] ?? 0
  const t: Vec3 = [at(12), at(13), at(14)]
  const columns = [0, 1, 2].map((i): Vec3 => [at(4 * i), at(4 * i + 1), at(4 * i + 2)])
  const result = new Float32Array(16)
  columns.forEach((column, i) => {
    result[i] = column[0]
    result[4 + i] = column[1]
    result[8 + i] = column[2]
    result[12 + i] = -dot(column, t)
  })
  result[15] = 1
  return result
}

/** Column-major from row-major. */
export function fromRowMajor(values: ArrayLike<number>): Float32Array {
  const result = new Float32Array(16)
  for (let i = 0; i < 16; i++) {
    result[4 * (i % 4) + Math.floor(i / 4)] = values[i] ?? 0
  }
  return result
}

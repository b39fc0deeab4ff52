/**
 * Real spherical harmonics up to degree 2, in the order and sign of protocol/CONVENTIONS.md.
 *
 * Coefficients of RGB functions are flat arrays of 27 numbers: index `3 * k + channel`.
 */

export const SH_COUNT = 9

export type Vec3 = readonly [number, number, number]

/** Band of basis function k. */
const BAND = [0, 1, 1, 1, 2, 2, 2, 2, 2] as const
/** Clamped-cosine kernel per band: pi, 2 pi / 3, pi / 4 (Ramamoorthi and Hanrahan 2001). */
const COSINE_KERNEL = [Math.PI, (2 * Math.PI) / 3, Math.PI / 4] as const

/** Y_k(direction) for a unit direction. */
export function shBasis(x: number, y: number, z: number): number[] {
  return [
    0.28209479177387814,
    0.4886025119029199 * y,
    0.4886025119029199 * z,
    0.4886025119029199 * x,
    1.0925484305920792 * x * y,
    1.0925484305920792 * y * z,
    0.31539156525252005 * (3 * z * z - 1),
    1.0925484305920792 * x * z,
    0.5462742152960396 * (x * x - y * y),
  ]
}

/** Value of an RGB function in a unit direction. */
export function evaluateSh(coeffs: ArrayLike<number>, direction: Vec3): [number, number, number] {
  return dotBasis(coeffs, shBasis(...direction), () => 1)
}

/** Irradiance on a surface with this unit normal, without occlusion. */
export function irradianceFromSh(coeffs: ArrayLike<number>, normal: Vec3): [number, number, number] {
  return dotBasis(coeffs, shBasis(...normal), (band) => COSINE_KERNEL[band as 0 | 1 | 2])
}

function dotBasis(
  coeffs: ArrayLike<number>,
  basis: readonly number[],
  kernel: (band: number) => number,
): [number, number, number] {
  const sum: [number, number, number] = [0, 0, 0]
  basis.forEach((value, k) => {
    const factor = value * kernel(BAND[k] ?? 0)
    sum[0] += factor * (coeffs[3 * k] ?? 0)
    sum[1] += factor * (coeffs[3 * k + 1] ?? 0)
    sum[2] += factor * (coeffs[3 * k + 2] ?? 0)
  })
  return sum
}

/** Adds light that comes from one direction only: `weight` is radiance times solid angle per channel. */
export function addDirectional(coeffs: Float32Array | Float64Array, direction: Vec3, weight: Vec3): void {
  shBasis(...direction).forEach((value, k) => {
    for (let channel = 0; channel < 3; channel++) {
      const at = 3 * k + channel
      coeffs[at] = (coeffs[at] ?? 0) + value * (weight[channel] ?? 0)
    }
  })
}

/** Directions whose band matrices are well conditioned. */
const BAND_1_DIRECTIONS: readonly Vec3[] = [
  [1, 0, 0],
  [0, 1, 0],
  [0, 0, 1],
]
const BAND_2_DIRECTIONS: readonly Vec3[] = [
  [1, 0, 0],
  [0, 0, 1],
  [Math.SQRT1_2, Math.SQRT1_2, 0],
  [Math.SQRT1_2, 0, Math.SQRT1_2],
  [0, Math.SQRT1_2, Math.SQRT1_2],
]
const BAND_1_INVERSE = invert(BAND_1_DIRECTIONS.map((d) => shBasis(...d).slice(1, 4)))
const BAND_2_INVERSE = invert(BAND_2_DIRECTIONS.map((d) => shBasis(...d).slice(4, 9)))

/**
 * The same function in turned axes.
 *
 * @param coeffs 27 numbers in source axes.
 * @param sourceFromTarget row-major 3x3 rotation: direction_source = M direction_target.
 * @returns 27 numbers in target axes.
 */
export function rotateSh(coeffs: ArrayLike<number>, sourceFromTarget: readonly number[]): Float32Array {
  const result = new Float32Array(27)
  for (let channel = 0; channel < 3; channel++) {
    result[channel] = coeffs[channel] ?? 0
  }
  rotateBand(coeffs, sourceFromTarget, BAND_1_DIRECTIONS, BAND_1_INVERSE, 1, result)
  rotateBand(coeffs, sourceFromTarget, BAND_2_DIRECTIONS, BAND_2_INVERSE, 4, result)
  return result
}

function rotateBand(
  coeffs: ArrayLike<number>,
  sourceFromTarget: readonly number[],
  directions: readonly Vec3[],
  inverse: readonly (readonly number[])[],
  first: number,
  result: Float32Array,
): void {
  const size = directions.length
  // A band is fixed by its values in as many directions as it has functions.
  const basis = directions.map((d) => shBasis(...transform3(sourceFromTarget, d)))
  for (let channel = 0; channel < 3; channel++) {
    const values = basis.map((row) => {
      let sum = 0
      for (let k = 0; k < size; k++) {
        sum += (row[first + k] ?? 0) * (coeffs[3 * (first + k) + channel] ?? 0)
      }
      return sum
    })
    for (let k = 0; k < size; k++) {
      let sum = 0
      values.forEach((value, i) => {
        sum += (inverse[k]?.[i] ?? 0) * value
      })
      result[3 * (first + k) + channel] = sum
    }
  }
}

/** Row-major 3x3 matrix times vector. */
export function transform3(matrix: readonly number[], v: Vec3): Vec3 {
  const row = (i: number): number =>
    (matrix[3 * i] ?? 0) * v[0] + (matrix[3 * i + 1] ?? 0) * v[1] + (matrix[3 * i + 2] ?? 0) * v[2]
  return [row(0), row(1), row(2)]
}

/** Inverse of a small matrix by Gauss-Jordan elimination with pivoting. */
function invert(matrix: readonly (readonly number[])[]): number[][] {
  const size = matrix.length
  const rows = matrix.map((row, i) => [...row, ...Array.from({ length: size }, (_, j) => (i === j ? 1 : 0))])
  for (let column = 0; column < size; column++) {
    let best = column
    for (let row = column + 1; row < size; row++) {
      if (Math.abs(rows[row]?.[column] ?? 0) > Math.abs(rows[best]?.[column] ?? 0)) {
        best = row
      }
    }
    ;[rows[column], rows[best]] = [rows[best] as number[], rows[column] as number[]]
    const pivotRow = rows[column] as number[]
    const pivot = pivotRow[column] as number
    rows[column] = pivotRow.map((value) => value / pivot)
    for (let other = 0; other < size; other++) {
      const factor = rows[other]?.[column] ?? 0
      if (other !== column && factor !== 0) {
        rows[other] = (rows[other] as number[]).map((v, j) => v - factor * (rows[column]?.[j] ?? 0))
      }
    }
  }
  return rows.map((row) => row.slice(size))
}

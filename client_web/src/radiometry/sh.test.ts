import fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import { addDirectional, evaluateSh, irradianceFromSh, rotateSh, shBasis, transform3, type Vec3 } from './sh'

const unit = fc
  .tuple(fc.double({ min: -1, max: 1, noNaN: true }), fc.double({ min: 0, max: 2 * Math.PI, noNaN: true }))
  .map(([z, phi]): Vec3 => {
    const r = Math.sqrt(1 - z * z)
    return [r * Math.cos(phi), r * Math.sin(phi), z]
  })
const coeffs = fc.array(fc.double({ min: -3, max: 3, noNaN: true }), { minLength: 27, maxLength: 27 })

/** Row-major rotation about a unit axis (Rodrigues). */
function rotation([x, y, z]: Vec3, angle: number): number[] {
  const c = Math.cos(angle)
  const s = Math.sin(angle)
  const d = 1 - c
  return [
    ...[c + d * x * x, d * x * y - s * z, d * x * z + s * y],
    ...[d * x * y + s * z, c + d * y * y, d * y * z - s * x],
    ...[d * x * z - s * y, d * y * z + s * x, c + d * z * z],
  ]
}

/** Fibonacci points: equal weights, accurate to 1e-4 for these low degrees. */
function sphere(count: number): Vec3[] {
  return Array.from({ length: count }, (_, i) => {
    const z = 1 - (2 * i + 1) / count
    const r = Math.sqrt(1 - z * z)
    const phi = i * 2.399963229728653
    return [r * Math.cos(phi), r * Math.sin(phi), z]
  })
}

describe('basis', () => {
  it('is orthonormal', () => {
    const points = sphere(20_000)
    for (let a = 0; a < 9; a++) {
      for (let b = 0; b <= a; b++) {
        const sum = points.reduce((total, p) => {
          const y = shBasis(...p)
          return total + (y[a] ?? 0) * (y[b] ?? 0)
        }, 0)
        expect((sum * 4 * Math.PI) / points.length).toBeCloseTo(a === b ? 1 : 0, 3)
      }
    }
  })
})

describe('irradiance', () => {
  it('of uniform radiance L is pi L everywhere', () => {
    const uniform = new Float64Array(27)
    uniform.set([2 * Math.sqrt(4 * Math.PI), 0, Math.sqrt(4 * Math.PI)])
    fc.assert(
      fc.property(unit, (normal) => {
        const [r, g, b] = irradianceFromSh(uniform, normal)
        expect(r).toBeCloseTo(2 * Math.PI, 6)
        expect(g).toBe(0)
        expect(b).toBeCloseTo(Math.PI, 6)
      }),
    )
  })

  it('of one direction is the clamped cosine up to its bands above 2', () => {
    const light = new Float64Array(27)
    addDirectional(light, [0, 0, 1], [1, 1, 1])
    // Ramamoorthi and Hanrahan 2001: 1/4 + x/2 + 5/32 (3 x^2 - 1).
    for (const x of [-1, -0.3, 0, 0.5, 1]) {
      const [value] = irradianceFromSh(light, [Math.sqrt(1 - x * x), 0, x])
      expect(value).toBeCloseTo(0.25 + 0.5 * x + (5 / 32) * (3 * x * x - 1), 10)
    }
  })
})

describe('rotation', () => {
  it('gives the same function in turned axes', () => {
    fc.assert(
      fc.property(
        coeffs,
        unit,
        fc.double({ min: -4, max: 4, noNaN: true }),
        unit,
        (values, axis, angle, direction) => {
          const sourceFromTarget = rotation(axis, angle)
          const turned = evaluateSh(rotateSh(values, sourceFromTarget), direction)
          const straight = evaluateSh(values, transform3(sourceFromTarget, direction))
          for (let channel = 0; channel < 3; channel++) {
            expect(turned[channel]).toBeCloseTo(straight[channel] ?? 0, 4)
          }
        },
      ),
    )
  })
})

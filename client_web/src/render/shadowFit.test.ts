import fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import { fitShadowMap, type Sphere, sameFit } from './shadowFit'
import { cross, dot, length, normalize, subtract, type Vec3 } from './vector'

const coordinate = fc.double({ min: -2, max: 2, noNaN: true })
const point = fc.tuple(coordinate, coordinate, coordinate) as fc.Arbitrary<Vec3>
const sphere = fc.record({ centre: point, radius: fc.double({ min: 0.02, max: 0.6, noNaN: true }) })
const direction = point.filter((p) => length(p) > 0.1).map(normalize)

/** Points of a sphere's surface. */
function surface({ centre, radius }: Sphere): Vec3[] {
  return Array.from({ length: 60 }, (_, i) => {
    const z = 1 - (2 * i + 1) / 60
    const r = Math.sqrt(1 - z * z)
    return [
      centre[0] + radius * r * Math.cos(2.4 * i),
      centre[1] + radius * r * Math.sin(2.4 * i),
      centre[2] + radius * z,
    ]
  })
}

describe('fitShadowMap', () => {
  it('keeps every object in front of the light inside the window, unless the light is next to it', () => {
    fc.assert(
      fc.property(
        point,
        direction,
        fc.array(sphere, { minLength: 1, maxLength: 4 }),
        (at, normal, spheres) => {
          fc.pre(spheres.every((s) => length(subtract(s.centre, at)) > 1.2 * s.radius))
          const fit = fitShadowMap(at, normal, 0.1, spheres)
          const lit = spheres.filter((s) => dot(subtract(s.centre, at), normal) > s.radius)
          if (lit.length === 0 || !fit) {
            expect(lit.length).toBe(0)
            return
          }
          const widest = Math.tan((75 * Math.PI) / 180)
          for (const p of lit.flatMap(surface)) {
            const offset = subtract(p, at)
            const z = dot(offset, fit.axis)
            const x = dot(offset, fit.right) / z
            const y = dot(offset, fit.up) / z
            if (z > 0 && Math.abs(x) < widest && Math.abs(y) < widest) {
              expect(x * fit.scale[0] + fit.offset[0]).toBeGreaterThanOrEqual(-1e-9)
              expect(x * fit.scale[0] + fit.offset[0]).toBeLessThanOrEqual(1 + 1e-9)
              expect(y * fit.scale[1] + fit.offset[1]).toBeGreaterThanOrEqual(-1e-9)
              expect(y * fit.scale[1] + fit.offset[1]).toBeLessThanOrEqual(1 + 1e-9)
            }
          }
        },
      ),
    )
  })

  it('is finite wherever the light touches an object, one kilometre away as well', () => {
    const far: Vec3 = [1000, -400, 700]
    const place = fc.constantFrom(0, 1e-9, 1e-3, 0.5, 1, 1 + 1e-9, 1.05, 2)
    fc.assert(
      fc.property(sphere, direction, direction, place, fc.boolean(), (s, towards, normal, reach, away) => {
        const centre = away ? (s.centre.map((x, i) => x + (far[i] ?? 0)) as unknown as Vec3) : s.centre
        const at = centre.map((x, i) => x + reach * s.radius * (towards[i] ?? 0)) as unknown as Vec3
        const fit = fitShadowMap(at, normal, 0.3, [{ centre, radius: s.radius }])
        if (fit) {
          const values = [
            ...fit.right,
            ...fit.up,
            ...fit.axis,
            ...fit.scale,
            ...fit.offset,
            fit.nearestCaster,
          ]
          expect(values.every(Number.isFinite)).toBe(true)
          expect(Math.min(...fit.scale)).toBeGreaterThan(0)
        }
      }),
    )
  })

  it('has right-handed unit axes that keep the winding: right x up = -axis', () => {
    fc.assert(
      fc.property(point, direction, sphere, (at, normal, s) => {
        const fit = fitShadowMap(at, normal, 0, [s])
        if (!fit) return
        cross(fit.right, fit.up).forEach((value, i) => {
          expect(value).toBeCloseTo(-(fit.axis[i] ?? 0), 9)
        })
      }),
    )
  })

  it('falls back to a wide window inside an object', () => {
    const fit = fitShadowMap([0, 0, 0], [0, 0, 1], 0.1, [{ centre: [0, 0, 0.1], radius: 0.5 }])
    expect(fit && 1 / fit.scale[0]).toBeGreaterThan(2 * Math.tan((74 * Math.PI) / 180))
  })

  it('needs no map for objects behind the light', () => {
    expect(fitShadowMap([0, 0, 0], [0, 0, 1], 0.1, [{ centre: [0, 0, -2], radius: 0.5 }])).toBeNull()
  })

  it('tells equal windows from others', () => {
    const spheres = [{ centre: [0, 0, 2] as Vec3, radius: 0.5 }]
    const fit = fitShadowMap([0, 0, 0], [0, 0, 1], 0.1, spheres)
    expect(sameFit(fit, fitShadowMap([0, 0, 0], [0, 0, 1], 0.1, spheres))).toBe(true)
    expect(sameFit(fit, fitShadowMap([0, 0, 0], [0, 0, 1], 0.2, spheres))).toBe(false)
    expect(sameFit(fit, null)).toBe(false)
  })
})

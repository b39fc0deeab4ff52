import fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import { centredLens, clipFromCamera, clipFromWorld, NEAR, resizeLens } from './camera'
import { transformPoint, type Vec3 } from './vector'

const lens = { width: 960, height: 540, fx: 798.85, fy: 790.1, cx: 470.2, cy: 275.9 }

/** Clip position, then window coordinates (x right, y down, pixel centres at integers) and window depth. */
function rasterise(m: Float32Array, p: Vec3, width: number, height: number): [number, number, number] {
  const row = (i: number): number =>
    (m[i] ?? 0) * p[0] + (m[4 + i] ?? 0) * p[1] + (m[8 + i] ?? 0) * p[2] + (m[12 + i] ?? 0)
  const w = row(3)
  return [((row(0) / w + 1) / 2) * width - 0.5, ((1 - row(1) / w) / 2) * height - 0.5, (row(2) / w + 1) / 2]
}

const pointInFront = fc.tuple(
  fc.double({ min: -3, max: 3, noNaN: true }),
  fc.double({ min: -3, max: 3, noNaN: true }),
  fc.double({ min: 0.06, max: 20, noNaN: true }),
) as fc.Arbitrary<Vec3>

describe('clipFromCamera', () => {
  it('projects as the calibration does, with depth 1 - near / z', () => {
    fc.assert(
      fc.property(pointInFront, (p) => {
        const [u, v, depth] = rasterise(clipFromCamera(lens), p, lens.width, lens.height)
        const exact = (lens.fx * p[0]) / p[2] + lens.cx
        expect(Math.abs(u - exact)).toBeLessThan(1e-3 + 1e-5 * Math.abs(exact))
        expect(Math.abs(v - ((lens.fy * p[1]) / p[2] + lens.cy))).toBeLessThan(1e-3 + 1e-5 * Math.abs(v))
        expect(depth).toBeCloseTo(1 - NEAR / p[2], 5)
      }),
    )
  })
})

describe('resizeLens', () => {
  it('keeps the field of view: pixel edges map to pixel edges', () => {
    const half = resizeLens(lens, 480, 270)
    fc.assert(
      fc.property(pointInFront, (p) => {
        const full = (lens.fx * p[0]) / p[2] + lens.cx
        const small = (half.fx * p[0]) / p[2] + half.cx
        expect((full + 0.5) / lens.width).toBeCloseTo((small + 0.5) / half.width, 9)
      }),
    )
  })
})

describe('clipFromWorld', () => {
  it('undoes the camera pose', () => {
    // Camera at (1, 2, 3) that looks along world -z with y up: OpenCV axes x, -y, -z.
    const worldFromCamera = Float32Array.of(1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 1, 2, 3, 1)
    const free = centredLens(200, 100, Math.PI / 2)
    const [u, v] = rasterise(clipFromWorld(free, worldFromCamera), [1, 3, 1], 200, 100)
    // Two metres ahead, one up: half-way between middle and top.
    expect(u).toBeCloseTo(99.5, 4)
    expect(v).toBeCloseTo(24.5, 4)
    expect(transformPoint(worldFromCamera, [0, -1, 2])).toEqual([1, 3, 1])
  })
})

describe('a room one kilometre from the origin', () => {
  /** What the vertex shader makes of it: every operation in float32, whatever the order of the sum. */
  function rasterise32(m: Float32Array, p: Vec3): [number, number] {
    const f = Math.fround
    const row = (i: number): number => {
      let sum = f(m[12 + i] ?? 0)
      for (let axis = 0; axis < 3; axis++) {
        sum = f(sum + f(f(m[4 * axis + i] ?? 0) * f(p[axis] ?? 0)))
      }
      return sum
    }
    const w = row(3)
    return [((row(0) / w + 1) / 2) * lens.width - 0.5, ((1 - row(1) / w) / 2) * lens.height - 0.5]
  }

  it('shakes by less than a third of a millimetre: a quarter of a pixel at one metre', () => {
    const angle = fc.double({ min: -Math.PI, max: Math.PI, noNaN: true })
    fc.assert(
      fc.property(pointInFront, angle, (p, yaw) => {
        fc.pre(p[2] > 0.2)
        const [c, s] = [Math.cos(yaw), Math.sin(yaw)]
        const columns = [c, 0, s, 0, 0, 1, 0, 0, -s, 0, c, 0]
        const far = Float32Array.of(...columns, 1000, -400, 700, 1)
        const exact = [...far]
        const point = transformPoint(exact, p).map(Math.fround) as unknown as Vec3
        const near = Float32Array.of(...columns, 0, 0, 0, 1)
        const offset: Vec3 = [point[0] - 1000, point[1] + 400, point[2] - 700]
        const wanted = rasterise(clipFromWorld(lens, near), offset, lens.width, lens.height)
        const found = rasterise32(clipFromWorld(lens, far), point)
        const depth = p[2]
        // Off the axis an error of depth counts as well.
        const slope = 1 + Math.hypot(p[0], p[1]) / depth
        const millimetres = [0, 1].map(
          (i) => (1000 * depth * Math.abs((found[i] ?? 0) - (wanted[i] ?? 0))) / lens.fx,
        )
        expect(Math.max(...millimetres) / slope).toBeLessThan(0.33)
      }),
      { numRuns: 500 },
    )
  })
})

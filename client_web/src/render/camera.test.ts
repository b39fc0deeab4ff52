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

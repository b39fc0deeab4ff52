import * as fc from 'fast-check'
import { Matrix4, Vector3 } from 'three'
import { describe, expect, it } from 'vitest'
import { cameraRay, freeLens } from './cameraRay'
import { angleDifference, ObjectMover, stepOnFloor } from './objectMover'
import { RoomSurface, type RoomTriangles } from './roomSurface'

const BOX = { minimum: [0, 0, 0], size: [4, 2.5, 4] } as const

/** Upward rectangles [x0, x1, z0, z1, y] and a wall that must not carry anything. */
function room(...levels: [number, number, number, number, number][]): RoomTriangles {
  const positions: number[] = []
  const indices: number[] = []
  for (const [x0, x1, z0, z1, y] of levels) {
    const base = positions.length / 3
    positions.push(x0, y, z0, x1, y, z0, x1, y, z1, x0, y, z1)
    indices.push(base, base + 2, base + 1, base, base + 3, base + 2)
  }
  const base = positions.length / 3
  positions.push(0, 0, 0, 4, 0, 0, 4, 2.5, 0, 0, 2.5, 0)
  indices.push(base, base + 1, base + 2, base, base + 2, base + 3)
  return { positions: new Float32Array(positions), indices: new Uint32Array(indices) }
}

const FLOOR_AND_TABLE = room([0, 4, 0, 4, 0], [1, 2, 1, 2, 0.75])

function moverAt(x: number, y: number, z: number): ObjectMover {
  const pose = new Matrix4().makeRotationY(0.3).setPosition(x, y, z)
  return new ObjectMover(new RoomSurface(FLOOR_AND_TABLE), BOX, [pose])
}

function positionOf(mover: ObjectMover): Vector3 {
  return new Vector3().setFromMatrixPosition(mover.pose(0))
}

const inside = fc.double({ min: 0.1, max: 3.9, noNaN: true })

describe('RoomSurface', () => {
  const surface = new RoomSurface(FLOOR_AND_TABLE)

  it('finds the highest surface below a point', () => {
    expect(surface.heightBelow(1.5, 1.5, 2)).toBeCloseTo(0.75, 6)
    expect(surface.heightBelow(1.5, 1.5, 0.7)).toBeCloseTo(0, 6)
    expect(surface.heightBelow(3, 3, 2)).toBeCloseTo(0, 6)
    expect(surface.heightBelow(5, 3, 2)).toBeNull()
  })

  it('has no gap along shared edges', () => {
    fc.assert(
      fc.property(inside, (x) => {
        expect(surface.heightBelow(x, x, 0.5)).not.toBeNull()
      }),
    )
  })

  it('ignores walls and undersides', () => {
    expect(surface.hit(new Vector3(2, 1, 2), new Vector3(0, 0, -1))).toBeNull()
    expect(surface.hit(new Vector3(1.5, 0.1, 1.5), new Vector3(0, 1, 0))).toBeNull()
  })
})

describe('ObjectMover', () => {
  it('keeps the grabbed point under the finger on one level', () => {
    fc.assert(
      fc.property(inside, inside, fc.double({ min: 0, max: 0.3, noNaN: true }), (x, z, lift) => {
        fc.pre(x > 2.2 && z > 2.2)
        const mover = moverAt(3, 0, 3)
        const eye = new Vector3(3.5, 1.6, 3.9)
        const grabbed = new Vector3(3.05, lift, 2.95)
        mover.beginDrag(0, grabbed)
        const goal = new Vector3(x, lift, z)
        mover.dragTo({ origin: eye, direction: goal.clone().sub(eye).normalize() })
        const found = positionOf(mover)
        const wanted = new Vector3(x - 0.05, 0, z + 0.05)
        wanted.x = Math.min(3.92, wanted.x)
        wanted.z = Math.min(3.92, wanted.z)
        expect(found.distanceTo(wanted)).toBeLessThan(1e-5)
      }),
    )
  })

  it('does not jump when a drag begins', () => {
    const mover = moverAt(1.5, 0.75, 1.5)
    const eye = new Vector3(2, 1.8, 3.5)
    const grabbed = new Vector3(1.52, 0.9, 1.55)
    mover.beginDrag(0, grabbed)
    mover.dragTo({ origin: eye, direction: grabbed.clone().sub(eye).normalize() })
    expect(positionOf(mover).distanceTo(new Vector3(1.5, 0.75, 1.5))).toBeLessThan(1e-6)
  })

  it('climbs the table and stays on surfaces', () => {
    fc.assert(
      fc.property(inside, inside, inside, inside, (x1, z1, x2, z2) => {
        const mover = moverAt(3, 0, 3)
        mover.beginDrag(0, new Vector3(3, 0.1, 3))
        const eye = new Vector3(2, 2.3, 3.8)
        for (const [x, z] of [
          [x1, z1],
          [x2, z2],
        ] as const) {
          mover.dragTo({ origin: eye, direction: new Vector3(x, 0, z).sub(eye).normalize() })
          const found = positionOf(mover)
          const surface = new RoomSurface(FLOOR_AND_TABLE).heightBelow(found.x, found.z, found.y + 0.02)
          expect(found.y).toBeCloseTo(surface ?? -1, 5)
        }
      }),
    )
    const mover = moverAt(3, 0, 3)
    mover.beginDrag(0, new Vector3(3, 0, 3))
    const eye = new Vector3(1.5, 2.3, 3.8)
    mover.dragTo({ origin: eye, direction: new Vector3(1.5, 0.75, 1.5).sub(eye).normalize() })
    expect(positionOf(mover).distanceTo(new Vector3(1.5, 0.75, 1.5))).toBeLessThan(1e-6)
  })

  it('stays where it is when the finger points at a wall', () => {
    const mover = moverAt(3, 0, 3)
    mover.beginDrag(0, new Vector3(3, 0.1, 3))
    expect(
      mover.dragTo({ origin: new Vector3(2, 1.5, 3), direction: new Vector3(0, 0.1, -1).normalize() }),
    ).toBe(false)
    expect(positionOf(mover)).toEqual(new Vector3(3, 0, 3))
  })

  it('turns about its own vertical', () => {
    const mover = moverAt(1.5, 0.75, 1.5)
    mover.rotate(0, Math.PI / 2)
    const expected = new Matrix4().makeRotationY(0.3 + Math.PI / 2).setPosition(1.5, 0.75, 1.5)
    mover.pose(0).elements.forEach((value, i) => {
      expect(value).toBeCloseTo(expected.elements[i] ?? 0, 12)
    })
  })

  it('steps down from the table, not up to it, by keys', () => {
    const mover = moverAt(1.5, 0.75, 1.5)
    mover.nudge(0, 1, 0)
    expect(positionOf(mover).toArray()).toEqual([2.5, 0, 1.5])
    mover.nudge(0, -1, 0)
    expect(positionOf(mover).toArray()).toEqual([1.5, 0, 1.5])
    mover.nudge(0, 100, -100)
    expect(positionOf(mover).x).toBeCloseTo(3.92, 12)
    expect(positionOf(mover).z).toBeCloseTo(0.08, 12)
  })

  it('restores the first pose', () => {
    const mover = moverAt(1.5, 0.75, 1.5)
    const first = mover.pose(0).clone()
    mover.nudge(0, 1, 0)
    mover.rotate(0, 1)
    mover.reset(0)
    expect(mover.pose(0)).toEqual(first)
  })
})

describe('gestures', () => {
  it('takes the shortest turn', () => {
    fc.assert(
      fc.property(
        fc.double({ min: -10, max: 10, noNaN: true }),
        fc.double({ min: -10, max: 10, noNaN: true }),
        (from, to) => {
          const turn = angleDifference(from, to)
          expect(Math.abs(turn)).toBeLessThanOrEqual(Math.PI + 1e-12)
          expect(Math.cos(from + turn)).toBeCloseTo(Math.cos(to), 9)
          expect(Math.sin(from + turn)).toBeCloseTo(Math.sin(to), 9)
        },
      ),
    )
  })

  it('reads steps as seen from the camera', () => {
    // OpenCV axes: x right, y down, z forward. Looking along world -z, right is world +x.
    const alongMinusZ = new Matrix4().makeBasis(
      new Vector3(1, 0, 0),
      new Vector3(0, -1, 0),
      new Vector3(0, 0, -1),
    )
    const step = stepOnFloor(alongMinusZ, 2, 3)
    expect([step.dx, step.dz]).toEqual([2, -3])
    const alongX = new Matrix4().makeBasis(new Vector3(0, 0, 1), new Vector3(0, -1, 0), new Vector3(1, 0, 0))
    const other = stepOnFloor(alongX, 2, 3)
    expect([other.dx, other.dz]).toEqual([3, 2])
  })
})

describe('cameraRay', () => {
  it('agrees with the pinhole projection', () => {
    const lens = { width: 960, height: 540, fx: 800, fy: 790, cx: 470, cy: 275 }
    const worldFromCamera = new Matrix4().makeRotationY(0.4).setPosition(1, 2, 3)
    const point = new Vector3(0.3, -0.2, 2).applyMatrix4(worldFromCamera)
    const pixelX = (800 * 0.3) / 2 + 470
    const pixelY = (790 * -0.2) / 2 + 275
    const ray = cameraRay(
      worldFromCamera,
      lens,
      ((pixelX + 0.5) / 960) * 2 - 1,
      1 - ((pixelY + 0.5) / 540) * 2,
    )
    const distance = point.distanceTo(ray.origin)
    expect(ray.direction.clone().multiplyScalar(distance).add(ray.origin).distanceTo(point)).toBeLessThan(
      1e-12,
    )
  })

  it('opens the free camera by its vertical field of view', () => {
    const lens = freeLens(Math.PI / 3, 1.5)
    const top = cameraRay(new Matrix4(), lens, 0, 1).direction
    expect(Math.atan2(-top.y, top.z)).toBeCloseTo(Math.PI / 6, 12)
    expect(top.x).toBeCloseTo(0, 12)
  })
})

import * as fc from 'fast-check'
import { Matrix4, Vector3 } from 'three'
import { describe, expect, it } from 'vitest'
import { OrbitCamera, pointInFront } from './orbitCamera'

const BOX = { minimum: [0, 0, 0], size: [4, 2.5, 3] } as const

function lookFrom(eye: Vector3, target: Vector3): Matrix4 {
  const worldFromView = new Matrix4().lookAt(eye, target, new Vector3(0, 1, 0)).setPosition(eye)
  return worldFromView.multiply(new Matrix4().makeScale(1, -1, -1))
}

function orbiting(): OrbitCamera {
  return new OrbitCamera(null, BOX, () => undefined)
}

describe('OrbitCamera', () => {
  it('takes over the pose of another camera', () => {
    const eye = new Vector3(1, 1.5, 2.5)
    const target = new Vector3(2, 0.5, 1)
    const camera = orbiting()
    camera.placeAt(lookFrom(eye, target), target)
    lookFrom(eye, target).elements.forEach((value, i) => {
      expect(camera.worldFromCamera().elements[i]).toBeCloseTo(value, 6)
    })
  })

  it('stays inside the room and upright, whatever keys are pressed', () => {
    const move = fc.record({
      azimuth: fc.double({ min: -1, max: 1, noNaN: true }),
      elevation: fc.double({ min: -1, max: 1, noNaN: true }),
      factor: fc.double({ min: 0.5, max: 2, noNaN: true }),
    })
    fc.assert(
      fc.property(fc.array(move, { maxLength: 20 }), (moves) => {
        const camera = orbiting()
        camera.placeAt(lookFrom(new Vector3(1, 1.5, 2.5), new Vector3(2, 0.5, 1)), new Vector3(2, 0.5, 1))
        for (const { azimuth, elevation, factor } of moves) {
          camera.orbit(azimuth, elevation)
          camera.dolly(factor)
          const pose = camera.worldFromCamera()
          const eye = new Vector3().setFromMatrixPosition(pose)
          expect(eye.x).toBeGreaterThanOrEqual(0.1)
          expect(eye.x).toBeLessThanOrEqual(3.9)
          expect(eye.y).toBeGreaterThanOrEqual(0.1)
          expect(eye.y).toBeLessThanOrEqual(2.4)
          expect(eye.z).toBeGreaterThanOrEqual(0.1)
          expect(eye.z).toBeLessThanOrEqual(2.9)
          expect(pose.determinant()).toBeCloseTo(1, 6)
          // OpenCV y points down, so its world height is negative for an upright camera.
          expect(new Vector3().setFromMatrixColumn(pose, 1).y).toBeLessThan(0)
        }
      }),
    )
  })

  it('goes around the point it looks at', () => {
    const target = new Vector3(2, 1, 1.5)
    const camera = orbiting()
    camera.placeAt(lookFrom(new Vector3(2, 1, 2.5), target), target)
    camera.orbit(Math.PI / 2, 0)
    const pose = camera.worldFromCamera()
    expect(new Vector3().setFromMatrixPosition(pose).distanceTo(new Vector3(3, 1, 1.5))).toBeLessThan(1e-6)
    expect(pointInFront(pose, 1).distanceTo(target)).toBeLessThan(1e-6)
  })
})

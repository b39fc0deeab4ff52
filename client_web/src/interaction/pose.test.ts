import * as fc from 'fast-check'
import { Vector3 } from 'three'
import { describe, expect, it } from 'vitest'
import { partsOfPose, poseFromParts, poseFromRowMajor, rowMajorOf } from './pose'

const number = fc.double({ min: -3, max: 3, noNaN: true })

describe('pose', () => {
  it('reads rows as rows', () => {
    // A quarter turn about +y and a shift: x goes to -z.
    const pose = poseFromRowMajor([0, 0, 1, 5, 0, 1, 0, 6, -1, 0, 0, 7, 0, 0, 0, 1])
    expect(new Vector3(1, 0, 0).applyMatrix4(pose).toArray()).toEqual([5, 6, 6])
    expect(rowMajorOf(pose)).toEqual([0, 0, 1, 5, 0, 1, 0, 6, -1, 0, 0, 7, 0, 0, 0, 1])
  })

  it('survives the way over the wire', () => {
    fc.assert(
      fc.property(number, number, number, number, number, number, number, (x, y, z, a, b, c, d) => {
        fc.pre(Math.hypot(a, b, c, d) > 0.1)
        const pose = poseFromParts({ position: [x, y, z], quaternion: [a, b, c, d] })
        const again = poseFromParts(partsOfPose(pose))
        pose.elements.forEach((value, i) => {
          expect(again.elements[i]).toBeCloseTo(value, 9)
        })
      }),
    )
  })
})

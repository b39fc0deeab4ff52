/** Poses between the forms that the scene, the wire and the renderer use. */
import { Matrix4, Quaternion, Vector3 } from 'three'

export type Pose = Matrix4

export interface PoseParts {
  /** Origin in world axes, metres. */
  readonly position: readonly [number, number, number]
  /** Unit quaternion x, y, z, w. */
  readonly quaternion: readonly [number, number, number, number]
}

/** @param values row-major 4x4, as in the scene description. */
export function poseFromRowMajor(values: readonly number[]): Pose {
  return new Matrix4().fromArray(values as number[]).transpose()
}

/** Row-major 4x4. */
export function rowMajorOf(pose: Pose): number[] {
  return pose.clone().transpose().toArray()
}

export function poseFromParts(parts: PoseParts): Pose {
  return new Matrix4().compose(
    new Vector3(...parts.position),
    new Quaternion(...parts.quaternion).normalize(),
    new Vector3(1, 1, 1),
  )
}

export function partsOfPose(pose: Pose): PoseParts {
  const position = new Vector3()
  const quaternion = new Quaternion()
  pose.decompose(position, quaternion, new Vector3())
  quaternion.normalize()
  return {
    position: [position.x, position.y, position.z],
    quaternion: [quaternion.x, quaternion.y, quaternion.z, quaternion.w],
  }
}

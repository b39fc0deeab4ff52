/** Poses of the virtual objects under fingers, mouse and keys. No events and no GL in here. */
import { Matrix4, Vector3 } from 'three'
import type { Ray } from './cameraRay'
import type { RoomSurface } from './roomSurface'

export interface WorldBox {
  readonly minimum: readonly [number, number, number]
  readonly size: readonly [number, number, number]
}

interface Drag {
  readonly objectIndex: number
  /** Height of the grabbed point above the surface that carries the object. */
  readonly lift: number
  /** From the surface below the grabbed point to the object's origin. */
  readonly originFromSurface: Vector3
}

/** Objects keep this distance from the walls. */
const WALL_MARGIN = 0.08
/** Surfaces whose heights differ by less are one surface. */
const LEVEL_TOLERANCE = 0.02
/** How high a key press can lift an object, e.g. onto a book. */
const STEP_UP = 0.1

const UP = new Vector3(0, 1, 0)

export class ObjectMover {
  readonly #surface: RoomSurface
  readonly #box: WorldBox
  readonly #poses: Matrix4[]
  readonly #initial: Matrix4[]
  #drag: Drag | null = null

  constructor(surface: RoomSurface, box: WorldBox, worldFromObject: readonly Matrix4[]) {
    this.#surface = surface
    this.#box = box
    this.#poses = worldFromObject.map((pose) => pose.clone())
    this.#initial = worldFromObject.map((pose) => pose.clone())
  }

  /** The object that is being dragged, or -1. */
  get dragged(): number {
    return this.#drag?.objectIndex ?? -1
  }

  pose(objectIndex: number): Matrix4 {
    const pose = this.#poses[objectIndex]
    if (!pose) {
      throw new RangeError(`object ${objectIndex}: expected an index below ${this.#poses.length}`)
    }
    return pose
  }

  /** Takes over a pose that was decided elsewhere. */
  setPose(objectIndex: number, worldFromObject: Matrix4): void {
    this.pose(objectIndex).copy(worldFromObject)
  }

  reset(objectIndex: number): void {
    this.pose(objectIndex).copy(this.#initial[objectIndex] as Matrix4)
  }

  beginDrag(objectIndex: number, grabbedWorld: Vector3): void {
    const origin = new Vector3().setFromMatrixPosition(this.pose(objectIndex))
    const support = this.#surface.heightBelow(origin.x, origin.z, origin.y + LEVEL_TOLERANCE) ?? origin.y
    const lift = Math.max(0, grabbedWorld.y - support)
    const originFromSurface = new Vector3(
      origin.x - grabbedWorld.x,
      origin.y - support,
      origin.z - grabbedWorld.z,
    )
    this.#drag = { objectIndex, lift, originFromSurface }
  }

  /**
   * Moves the dragged object so that the grabbed point stays on the ray while the object stays on the room's surfaces.
   *
   * @returns whether the pose changed; it does not when the object would lose its footing or leave the room.
   */
  dragTo(ray: Ray): boolean {
    if (!this.#drag) {
      return false
    }
    const { objectIndex, lift, originFromSurface } = this.#drag
    const distance = this.#surface.hit(ray.origin, ray.direction, lift)
    if (distance === null) {
      return false
    }
    const target = ray.direction.clone().multiplyScalar(distance).add(ray.origin)
    const level = target.y - lift
    target.y = level
    target.add(originFromSurface)
    this.#clamp(target)
    const support = this.#surface.heightBelow(target.x, target.z, level + LEVEL_TOLERANCE)
    if (support === null || Math.abs(support - level) > LEVEL_TOLERANCE) {
      return false
    }
    return this.#place(objectIndex, target)
  }

  endDrag(): void {
    this.#drag = null
  }

  /** Turns an object about the vertical through its origin; positive = counter-clockwise seen from above. */
  rotate(objectIndex: number, angle: number): boolean {
    if (angle === 0) {
      return false
    }
    const pose = this.pose(objectIndex)
    const origin = new Vector3().setFromMatrixPosition(pose)
    pose.premultiply(new Matrix4().makeRotationAxis(UP, angle)).setPosition(origin)
    return true
  }

  /** Shifts an object over the surface that carries it, e.g. by keys. Metres, world axes. */
  nudge(objectIndex: number, dx: number, dz: number): boolean {
    const origin = new Vector3().setFromMatrixPosition(this.pose(objectIndex))
    const before = this.#surface.heightBelow(origin.x, origin.z, origin.y + LEVEL_TOLERANCE)
    const target = new Vector3(origin.x + dx, origin.y, origin.z + dz)
    this.#clamp(target)
    const after = this.#surface.heightBelow(target.x, target.z, origin.y + STEP_UP)
    if (before !== null && after !== null) {
      target.y += after - before
    }
    return this.#place(objectIndex, target)
  }

  #clamp(position: Vector3): void {
    const [minX, , minZ] = this.#box.minimum
    const [sizeX, , sizeZ] = this.#box.size
    const marginX = Math.min(WALL_MARGIN, sizeX / 2)
    const marginZ = Math.min(WALL_MARGIN, sizeZ / 2)
    position.x = Math.min(minX + sizeX - marginX, Math.max(minX + marginX, position.x))
    position.z = Math.min(minZ + sizeZ - marginZ, Math.max(minZ + marginZ, position.z))
  }

  #place(objectIndex: number, position: Vector3): boolean {
    const pose = this.pose(objectIndex)
    const before = new Vector3().setFromMatrixPosition(pose)
    if (before.equals(position)) {
      return false
    }
    pose.setPosition(position)
    return true
  }
}

/** Angle of the second finger seen from the first, clockwise on the screen (y points down). */
export function twistAngle(x1: number, y1: number, x2: number, y2: number): number {
  return Math.atan2(y2 - y1, x2 - x1)
}

/** The shortest turn from one angle to another, in (-pi, pi]. */
export function angleDifference(from: number, to: number): number {
  const turn = (to - from) % (2 * Math.PI)
  if (turn > Math.PI) {
    return turn - 2 * Math.PI
  }
  return turn <= -Math.PI ? turn + 2 * Math.PI : turn
}

/** A step seen from the camera (x to the right, y away from it) as world (dx, dz) on the floor. */
export function stepOnFloor(
  worldFromCamera: Matrix4,
  right: number,
  away: number,
): { dx: number; dz: number } {
  const rightAxis = new Vector3().setFromMatrixColumn(worldFromCamera, 0)
  const forward = new Vector3().setFromMatrixColumn(worldFromCamera, 2)
  const length = Math.hypot(rightAxis.x, rightAxis.z) || 1
  const [rx, rz] = [rightAxis.x / length, rightAxis.z / length]
  // Forward on the floor is a quarter turn from right; the sign keeps it right when the camera is rolled over.
  const sign = forward.x * rz - forward.z * rx >= 0 ? 1 : -1
  return { dx: right * rx + sign * away * rz, dz: right * rz - sign * away * rx }
}

/** Virtual objects: what fingers do reaches the picture at once and the server at a bearable rate. */
import type { Ray } from '../interaction/cameraRay'
import { ObjectMover, stepOnFloor } from '../interaction/objectMover'
import type { PointerTarget } from '../interaction/pointerInput'
import { type Pose, type PoseParts, partsOfPose, poseFromParts, poseFromRowMajor } from '../interaction/pose'
import { RoomSurface, type RoomTriangles } from '../interaction/roomSurface'
import type { SceneDescription } from '../state/sceneDescription'

export interface ObjectEvents {
  /** The pose to draw from now on. */
  poseChanged(objectIndex: number, worldFromObject: Pose): void
  /** The same, for the server. */
  poseToSend(objectIndex: number, parts: PoseParts): void
  selected(objectIndex: number): void
  /** Whether the server's view of this object may be older than ours. */
  isUnsettled(objectIndex: number): boolean
  pick: PointerTarget['pickObject']
  ray(xNdc: number, yNdc: number): Ray
}

const STEP = 0.02
const KEY_TURN = Math.PI / 36

export class ObjectControl implements PointerTarget {
  readonly #mover: ObjectMover
  readonly #events: ObjectEvents
  readonly #numObjects: number
  #selected = -1

  constructor(scene: SceneDescription, room: RoomTriangles, events: ObjectEvents) {
    this.#numObjects = scene.objects.length
    this.#events = events
    this.#mover = new ObjectMover(
      new RoomSurface(room),
      scene.room.bounds,
      scene.objects.map((each) => poseFromRowMajor(each.world_from_object)),
    )
  }

  get selected(): number {
    return this.#selected
  }

  pose(objectIndex: number): Pose {
    return this.#mover.pose(objectIndex)
  }

  /** What the server says; an object under a finger, or one just moved, keeps the local pose. */
  applyServerPose(objectIndex: number, parts: PoseParts): void {
    if (
      objectIndex >= this.#numObjects ||
      this.#mover.dragged === objectIndex ||
      this.#events.isUnsettled(objectIndex)
    ) {
      return
    }
    const pose = poseFromParts(parts)
    if (!almostEqual(pose, this.#mover.pose(objectIndex))) {
      this.#mover.setPose(objectIndex, pose)
      this.#events.poseChanged(objectIndex, this.#mover.pose(objectIndex))
    }
  }

  pickObject(xNdc: number, yNdc: number): ReturnType<PointerTarget['pickObject']> {
    return this.#events.pick(xNdc, yNdc)
  }

  select(objectIndex: number): void {
    if (this.#selected !== objectIndex && objectIndex < this.#numObjects) {
      this.#selected = objectIndex
      this.#events.selected(objectIndex)
    }
  }

  beginDrag(objectIndex: number, positionWorld: Parameters<PointerTarget['beginDrag']>[1]): void {
    this.#mover.beginDrag(objectIndex, positionWorld)
  }

  dragTo(xNdc: number, yNdc: number): void {
    const objectIndex = this.#mover.dragged
    if (this.#mover.dragTo(this.#events.ray(xNdc, yNdc))) {
      this.#moved(objectIndex)
    }
  }

  endDrag(): void {
    this.#mover.endDrag()
  }

  rotate(objectIndex: number, angle: number): void {
    if (objectIndex >= 0 && this.#mover.rotate(objectIndex, angle)) {
      this.#moved(objectIndex)
    }
  }

  reset(objectIndex: number): void {
    if (objectIndex >= 0) {
      this.#mover.reset(objectIndex)
      this.#moved(objectIndex)
    }
  }

  /** Steps of the arrow keys as seen from the camera; `coarse` = the larger step. */
  stepSelected(right: number, away: number, worldFromCamera: Pose, coarse: boolean): void {
    if (this.#selected < 0) {
      return
    }
    const size = coarse ? 5 * STEP : STEP
    const { dx, dz } = stepOnFloor(worldFromCamera, right * size, away * size)
    if (this.#mover.nudge(this.#selected, dx, dz)) {
      this.#moved(this.#selected)
    }
  }

  turnSelected(direction: number): void {
    this.rotate(this.#selected, direction * KEY_TURN)
  }

  setPose(objectIndex: number, pose: Pose): void {
    this.#mover.setPose(objectIndex, pose)
    this.#moved(objectIndex)
  }

  #moved(objectIndex: number): void {
    const pose = this.#mover.pose(objectIndex)
    this.#events.poseChanged(objectIndex, pose)
    this.#events.poseToSend(objectIndex, partsOfPose(pose))
  }
}

/** The wire carries float32; a difference of that size is no movement. */
function almostEqual(a: Pose, b: Pose): boolean {
  return a.elements.every((value, i) => Math.abs(value - (b.elements[i] as number)) < 1e-6)
}

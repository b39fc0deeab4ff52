/** The free camera: orbits with one finger, pans and zooms with two, and stays inside the room. */
import { Box3, Matrix4, PerspectiveCamera, Vector3 } from 'three'
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js'
import type { WorldBox } from './objectMover'

/** Turns OpenCV camera axes (x right, y down, z forward) into OpenGL view axes; its own inverse. */
const VIEW_FROM_CAMERA = new Matrix4().makeScale(1, -1, -1)
const WALL_MARGIN = 0.12
const DEFAULT_VERTICAL_FOV = Math.PI / 4

export class OrbitCamera {
  readonly #camera = new PerspectiveCamera()
  readonly #controls: OrbitControls
  readonly #limits: Box3
  readonly #worldFromCamera = new Matrix4()

  /** @param onChange called when a finger, the mouse or inertia moved the camera. */
  constructor(element: HTMLElement | null, box: WorldBox, onChange: () => void) {
    this.#limits = insideOf(box)
    this.#controls = new OrbitControls(this.#camera, element)
    this.#controls.enabled = false
    this.#controls.enableDamping = true
    this.#controls.dampingFactor = 0.12
    this.#controls.minDistance = 0.25
    this.#controls.maxDistance = this.#limits.getSize(new Vector3()).length()
    this.#controls.addEventListener('change', onChange)
    this.verticalFov = DEFAULT_VERTICAL_FOV
  }

  /** Radians. */
  verticalFov: number

  get enabled(): boolean {
    return this.#controls.enabled
  }

  set enabled(enabled: boolean) {
    this.#controls.enabled = enabled
  }

  /** Takes the place of another camera and orbits around `target`, kept inside the room. World, metres. */
  placeAt(worldFromCamera: Matrix4, target: Vector3): void {
    const worldFromView = new Matrix4().multiplyMatrices(worldFromCamera, VIEW_FROM_CAMERA)
    worldFromView.decompose(this.#camera.position, this.#camera.quaternion, this.#camera.scale)
    this.#controls.target.copy(target).clamp(this.#limits.min, this.#limits.max)
    this.update()
  }

  /** Applies inertia and limits; call once per frame. Returns whether the camera moved. */
  update(): boolean {
    const moved = this.#controls.update()
    this.#controls.target.clamp(this.#limits.min, this.#limits.max)
    this.#camera.position.clamp(this.#limits.min, this.#limits.max)
    this.#camera.lookAt(this.#controls.target)
    this.#camera.updateMatrixWorld()
    return moved
  }

  /** Orbits by keys; radians. */
  orbit(azimuth: number, elevation: number): void {
    const offset = this.#camera.position.clone().sub(this.#controls.target)
    const radius = offset.length()
    const theta = Math.atan2(offset.x, offset.z) + azimuth
    const phi = Math.min(Math.PI - 0.05, Math.max(0.05, Math.acos(offset.y / radius) - elevation))
    offset.setFromSphericalCoords(radius, phi, theta)
    this.#camera.position.copy(this.#controls.target).add(offset)
    this.update()
  }

  /** Goes nearer (factor below 1) or farther by keys. */
  dolly(factor: number): void {
    const offset = this.#camera.position.clone().sub(this.#controls.target)
    const radius = Math.min(
      this.#controls.maxDistance,
      Math.max(this.#controls.minDistance, offset.length() * factor),
    )
    this.#camera.position.copy(this.#controls.target).add(offset.setLength(radius))
    this.update()
  }

  /** Pose in OpenCV axes; the same matrix is returned by every call. */
  worldFromCamera(): Matrix4 {
    return this.#worldFromCamera.multiplyMatrices(this.#camera.matrixWorld, VIEW_FROM_CAMERA)
  }

  dispose(): void {
    this.#controls.dispose()
  }
}

/** A point that the camera looks at, `distance` in front of it. */
export function pointInFront(worldFromCamera: Matrix4, distance: number): Vector3 {
  const forward = new Vector3().setFromMatrixColumn(worldFromCamera, 2)
  return forward.multiplyScalar(distance).add(new Vector3().setFromMatrixPosition(worldFromCamera))
}

function insideOf(box: WorldBox): Box3 {
  const minimum = new Vector3(...box.minimum)
  const size = new Vector3(...box.size)
  const margin = Math.min(WALL_MARGIN, Math.min(size.x, size.y, size.z) / 4)
  return new Box3(minimum.clone().addScalar(margin), minimum.clone().add(size).subScalar(margin))
}

/** Which camera shows the picture: one of the fixed tablet views, or the free one. */
import { cameraRay, freeLens, type Ray } from '../interaction/cameraRay'
import { OrbitCamera, pointInFront } from '../interaction/orbitCamera'
import { type Pose, poseFromRowMajor } from '../interaction/pose'
import type { SceneDescription, ViewDescription } from '../state/sceneDescription'
import type { ViewChoice } from '../ui/shell'
import type { CameraChoice } from './ports'

/** Distance of the point that the free camera orbits, as a share of the room's longest side. */
const ORBIT_SHARE = 0.45

export class CameraControl {
  readonly #views: readonly ViewDescription[]
  readonly #poses: readonly Pose[]
  readonly #orbit: OrbitCamera
  readonly #orbitDistance: number
  #view: ViewChoice
  #placed = false
  #changed = true

  /** @param onChange called when the free camera moved by itself or by fingers. */
  constructor(scene: SceneDescription, element: HTMLElement | null, onChange: () => void) {
    this.#views = scene.views
    this.#poses = scene.views.map((view) => poseFromRowMajor(view.world_from_camera))
    const { bounds } = scene.room
    this.#orbitDistance = ORBIT_SHARE * Math.max(...bounds.size)
    this.#orbit = new OrbitCamera(element, bounds, () => {
      this.#changed = true
      onChange()
    })
    this.#view = scene.views.length > 0 ? 0 : 'free'
    this.#orbit.enabled = this.#view === 'free'
    if (this.#view === 'free') {
      this.#placeInMiddle(bounds)
    }
  }

  get view(): ViewChoice {
    return this.#view
  }

  /** Width to height of the picture, or null if it takes whatever space there is. */
  get aspect(): number | null {
    const view = this.#description
    return view ? view.width / view.height : null
  }

  get hasBackground(): boolean {
    return (this.#description?.background_urls.length ?? 0) > 0
  }

  select(view: ViewChoice): void {
    const from = this.#view
    this.#view = view
    this.#orbit.enabled = view === 'free'
    this.#changed = true
    // The free camera starts where the tablet stood, and later where it was left.
    if (view === 'free' && !this.#placed && typeof from === 'number') {
      const pose = this.#poses[from]
      const description = this.#views[from]
      if (pose && description) {
        this.#orbit.verticalFov = 2 * Math.atan(description.height / 2 / description.fy)
        this.#orbit.placeAt(pose, pointInFront(pose, this.#orbitDistance))
        this.#placed = true
      }
    }
  }

  /** Advances inertia; returns whether the camera still moves. */
  update(): boolean {
    return this.#view === 'free' && this.#orbit.update()
  }

  /** The camera if it changed since the last call, else null. */
  takeChange(): CameraChoice | null {
    if (!this.#changed) {
      return null
    }
    this.#changed = false
    return this.choice()
  }

  choice(): CameraChoice {
    if (this.#view === 'free') {
      return {
        kind: 'free',
        worldFromCamera: this.#orbit.worldFromCamera(),
        verticalFov: this.#orbit.verticalFov,
      }
    }
    return { kind: 'tablet', viewIndex: this.#view }
  }

  worldFromCamera(): Pose {
    return this.#view === 'free' ? this.#orbit.worldFromCamera() : (this.#poses[this.#view] as Pose)
  }

  /** @param aspect of the picture on the screen. */
  ray(xNdc: number, yNdc: number, aspect: number): Ray {
    const lens = this.#description ?? freeLens(this.#orbit.verticalFov, aspect)
    return cameraRay(this.worldFromCamera(), lens, xNdc, yNdc)
  }

  orbitBy(azimuth: number, elevation: number): void {
    this.#orbit.orbit(azimuth, elevation)
    this.#changed = true
  }

  dollyBy(factor: number): void {
    this.#orbit.dolly(factor)
    this.#changed = true
  }

  dispose(): void {
    this.#orbit.dispose()
  }

  get #description(): ViewDescription | undefined {
    return this.#view === 'free' ? undefined : this.#views[this.#view]
  }

  /** For rooms without tablet views: eye height, at the side, looking at the middle. */
  #placeInMiddle(bounds: SceneDescription['room']['bounds']): void {
    const [x, y, z] = bounds.minimum
    const [sizeX, sizeY, sizeZ] = bounds.size
    // OpenCV axes: x right, y down, z forward along world -z.
    const pose = poseFromRowMajor([
      ...[1, 0, 0, x + sizeX / 2],
      ...[0, -1, 0, y + sizeY / 2],
      ...[0, 0, -1, z + 0.9 * sizeZ],
      ...[0, 0, 0, 1],
    ])
    this.#orbit.placeAt(pose, pointInFront(pose, this.#orbitDistance))
    this.#placed = true
  }
}

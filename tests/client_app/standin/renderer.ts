/**
 * Draws the page's picture without WebGL: a floor, and one disc per object, as bright as the light that arrived.
 * It has the interface of the renderer and counts what it is told, so that page tests are quick and exact.
 */
import type { CameraChoice, FrameReport, PictureRenderer, RendererSettings } from '../../../client_web/src/app/ports'
import type { Pose } from '../../../client_web/src/interaction/pose'
import type { LightFrame } from '../../../client_web/src/state/lightState'
import type { SceneDescription } from '../../../client_web/src/state/sceneDescription'

export class StandInRenderer implements PictureRenderer {
  readonly calls: Record<string, number> = {}
  readonly #canvas: HTMLCanvasElement
  readonly #context: CanvasRenderingContext2D
  readonly #scene: SceneDescription
  readonly #poses = new Map<number, Pose>()
  #settings: RendererSettings
  #camera: CameraChoice = { kind: 'tablet', viewIndex: 0 }
  #weights = new Float32Array(0)
  #radiantIntensity = 0

  constructor(canvas: HTMLCanvasElement, scene: SceneDescription, settings: RendererSettings) {
    this.#canvas = canvas
    this.#scene = scene
    this.#settings = settings
    this.#context = canvas.getContext('2d') as CanvasRenderingContext2D
  }

  setLight(frame: LightFrame): void {
    this.#count('setLight')
    this.#radiantIntensity = 0
    for (let slot = 0; slot < frame.count; slot++) {
      this.#radiantIntensity += frame.vals[16 * slot + 8] ?? 0
    }
  }

  setCamera(camera: CameraChoice): void {
    this.#count('setCamera')
    this.#camera = camera
  }

  setObjectPose(objectIndex: number, worldFromObject: Pose): void {
    this.#count('setObjectPose')
    this.#poses.set(objectIndex, worldFromObject.clone())
  }

  setLightWeights(weights: Float32Array): void {
    this.#count('setLightWeights')
    this.#weights = weights.slice()
  }

  updateAtlas(): void {
    this.#count('updateAtlas')
  }

  setOptions(partial: Partial<RendererSettings>): void {
    this.#count('setOptions')
    this.#settings = { ...this.#settings, ...partial }
  }

  setSize(width: number, height: number): void {
    this.#count('setSize')
    this.#canvas.width = width
    this.#canvas.height = height
  }

  render(): FrameReport {
    this.#count('render')
    const { width, height } = this.#canvas
    const context = this.#context
    const sum = this.#weights.reduce((total, weight) => total + weight, 0)
    const level = (share: number): string => {
      const grey = Math.round(255 * Math.min(1, share) ** 0.45)
      return `rgb(${grey}, ${grey}, ${grey})`
    }
    const room = 0.15 * this.#settings.exposure * sum
    context.fillStyle = level(room)
    context.fillRect(0, 0, width, height)
    context.fillStyle = level(0.6 * room)
    context.fillRect(0, 0.6 * height, width, 0.4 * height)
    this.#scene.objects.forEach((each) => {
      const [x, y] = this.#centre(each.index)
      context.fillStyle = level(0.05 * this.#settings.exposure * this.#radiantIntensity)
      context.beginPath()
      context.arc(((x + 1) / 2) * width, ((1 - y) / 2) * height, 0.12 * height, 0, 2 * Math.PI)
      context.fill()
    })
    return {
      passes: [
        { name: 'background', ran: true, reason: 'light weights' },
        { name: 'shadows', ran: false, reason: 'nothing moved' },
      ],
      cpuMs: 0.1,
      pending: false,
    }
  }

  readComposite(): Float32Array {
    this.#count('readComposite')
    return new Float32Array(4 * this.#canvas.width * this.#canvas.height).fill(0.5 + this.#radiantIntensity)
  }

  pick(xNdc: number, yNdc: number): ReturnType<PictureRenderer['pick']> {
    const aspect = this.#canvas.width / this.#canvas.height
    for (const each of this.#scene.objects) {
      const [x, y] = this.#centre(each.index)
      if (Math.hypot((xNdc - x) * aspect, yNdc - y) < 0.24) {
        const position = this.#poses.get(each.index)?.elements.slice(12, 15) ?? [0, 0, 0]
        return {
          objectIndex: each.index,
          positionWorld: { x: position[0] as number, y: position[1] as number, z: position[2] as number },
        }
      }
    }
    return null
  }

  dispose(): void {}

  /** Where the object's origin is in the picture, normalised device coordinates. */
  #centre(objectIndex: number): [number, number] {
    const view = this.#scene.views[this.#camera.kind === 'tablet' ? this.#camera.viewIndex : 0]
    const pose = this.#poses.get(objectIndex)
    if (!view || !pose) {
      return [0, 0]
    }
    const m = view.world_from_camera
    const d = [0, 1, 2].map((row) => (pose.elements[12 + row] as number) - (m[4 * row + 3] as number))
    const camera = [0, 1, 2].map(
      (column) =>
        (d[0] as number) * (m[column] as number) +
        (d[1] as number) * (m[4 + column] as number) +
        (d[2] as number) * (m[8 + column] as number),
    )
    const [x, y, z] = camera as [number, number, number]
    const pixelX = (view.fx * x) / z + view.cx
    const pixelY = (view.fy * y) / z + view.cy
    return [((pixelX + 0.5) / view.width) * 2 - 1, 1 - ((pixelY + 0.5) / view.height) * 2]
  }

  #count(name: string): void {
    this.calls[name] = (this.calls[name] ?? 0) + 1
  }
}

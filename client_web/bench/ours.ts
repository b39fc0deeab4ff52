/** The renderer of the product, as the page uses it while the picture is live. */
import { Matrix4 } from 'three'
import { MAX_VALS } from '../src/radiometry/valLight'
import { Renderer } from '../src/render/renderer'
import type { FrameStats } from '../src/render/types'
import { type BenchLight, type BenchScene, lampWeights, movedVals, objectPose } from './scene'
import type { DrawingOptions, FrameKind, Variant } from './variant'

const NO_SLOTS = new Uint8Array(MAX_VALS)
const MOVED: Readonly<
  Record<FrameKind, { lights: boolean; colours: boolean; objects: boolean; video: boolean }>
> = {
  full: { lights: true, colours: true, objects: true, video: true },
  video: { lights: false, colours: false, objects: false, video: true },
  'light colour': { lights: false, colours: true, objects: false, video: false },
  'lights moved': { lights: true, colours: true, objects: false, video: false },
  'objects moved': { lights: false, colours: false, objects: true, video: false },
  'same maps': { lights: true, colours: true, objects: true, video: true },
  camera: { lights: false, colours: false, objects: false, video: false },
}

export class Ours implements Variant {
  readonly canvas: HTMLCanvasElement
  readonly gl: WebGL2RenderingContext
  readonly #renderer: Renderer
  readonly #scene: BenchScene
  readonly #light: BenchLight
  /** Of the last frame: which passes ran. */
  stats: FrameStats = { passes: [], cpuMs: 0, pending: false }

  static async create(
    scene: BenchScene,
    light: BenchLight,
    exposure: number,
    drawing: DrawingOptions,
  ): Promise<Ours> {
    const canvas = document.createElement('canvas')
    const renderer = await Renderer.create(canvas, scene.assets, { exposure, shadows: drawing.shadows })
    renderer.setSize(scene.lens.width, scene.lens.height)
    renderer.setCamera({ kind: 'tablet', viewIndex: 0 })
    const shown = drawing.lights ? light : { ...light, count: 0, objectSh: light.objectSh.map(() => 0) }
    return new Ours(canvas, renderer, scene, shown)
  }

  private constructor(canvas: HTMLCanvasElement, renderer: Renderer, scene: BenchScene, light: BenchLight) {
    this.canvas = canvas
    this.gl = canvas.getContext('webgl2') as WebGL2RenderingContext
    this.#renderer = renderer
    this.#scene = scene
    this.#light = light
  }

  draw(frame: number, kind: FrameKind): void {
    const moved = MOVED[kind]
    if (moved.lights || moved.colours) this.#moveLight(frame, moved.lights)
    if (moved.objects) {
      this.#scene.assets.objects.forEach((_, index) => {
        const pose = new Matrix4().fromArray(objectPose(this.#scene, index, frame)).transpose()
        this.#renderer.setObjectPose(index, pose)
      })
    }
    if (moved.video) this.#renderer.setLightWeights(lampWeights(this.#scene, frame))
    if (kind === 'camera') this.#renderer.setCamera({ kind: 'tablet', viewIndex: 0 })
    this.stats = this.#renderer.render(performance.now())
  }

  #moveLight(frame: number, moved: boolean): void {
    const { count, objectSh } = this.#light
    const vals = movedVals(this.#light, moved ? frame : 0)
    this.#renderer.setLight({
      vals: moved ? vals : vals.map((value, i) => (i % 16 >= 8 ? value * (1 + 1e-3 * (frame % 2)) : value)),
      count,
      objectSh,
      positionsChanged: moved,
      changedSlots: moved ? new Uint8Array(MAX_VALS).fill(1, 0, count) : NO_SLOTS,
      revision: frame,
    })
  }

  /** Draws until no shadow map is left over, so that the next frame starts from a finished one. */
  settle(): void {
    while (this.stats.pending) this.stats = this.#renderer.render(performance.now())
  }

  dispose(): void {
    this.#renderer.dispose()
    this.gl.getExtension('WEBGL_lose_context')?.loseContext()
  }
}

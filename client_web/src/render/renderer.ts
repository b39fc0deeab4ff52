/** Draws the augmented picture: Rohmer et al. 2014, section 5, with WebGL2 in place of compute and geometry shaders. */
import { Vector3 } from 'three'
import type { AtlasTiles } from '../protocol/codec'
import { MAX_VALS } from '../radiometry/valLight'
import type { LightFrame } from '../state/lightState'
import { centredLens, clipFromWorld, type Lens, resizeLens } from './camera'
import { type Device, openDevice, probeDevice, resetState } from './device'
import { RendererError } from './errors'
import type { Target } from './gl/targets'
import { GpuState, type SizedTargets } from './gpuState'
import { packVals } from './lightData'
import { lightObject } from './lightSetup'
import { MAX_OBJECTS, type ObjectState, packObjects, worldCentre } from './objectData'
import type { CameraState, Frame } from './passes/frame'
import type { ShadingMode } from './passes/shadePass'
import { type Key, OPTION_KEYS } from './passKeys'
import { PassRunner } from './passRunner'
import { pickSurface } from './pick'
import { LIVE_MAPS_PER_FRAME, ShadowMaps } from './shadowMaps'
import { StreamedAtlas } from './streamedAtlas'
import {
  type CameraChoice,
  DEFAULT_OPTIONS,
  type FrameStats,
  type MatrixLike,
  type RendererOptions,
  type SceneAssets,
} from './types'
import { fromRowMajor } from './vector'

/** Share of white that the VALs left out of a tile may amount to while the picture is live. */
const NEGLIGIBLE = 0.5 / 255
/** Part of white below which a VAL's shadow need not be sampled as finely. */
const FAINT = 4 / 255
/** Exposures within this factor share one choice of VALs, so the error stays below 2 NEGLIGIBLE. */
const EXPOSURE_SLACK = 2

export interface PickedSurface {
  /** -1 = a real surface. */
  readonly objectIndex: number
  readonly positionWorld: Vector3
  readonly normalWorld: Vector3
}

export class Renderer {
  readonly #canvas: HTMLCanvasElement
  readonly #assets: SceneAssets
  readonly #options: RendererOptions
  readonly #runner = new PassRunner<Key>()
  readonly #maps = new ShadowMaps()
  readonly #poses: Float32Array[]
  readonly #changedSlots = new Uint8Array(MAX_VALS)
  readonly #atlas = new StreamedAtlas()
  #vals = new Float32Array(MAX_VALS * 16)
  #valCount = 0
  #objectSh: Float32Array
  #weights: Float32Array
  #objects: ObjectState[] = []
  #camera: CameraChoice = { kind: 'tablet', viewIndex: 0 }
  #size = { width: 1, height: 1 }
  #device: Device
  #gpu: GpuState
  #objectsMoved = true
  #mode: ShadingMode = 'composite'
  /** By which VALs were last found negligible. */
  #judgedExposure: number
  #lost = false

  /**
   * Makes a renderer on a canvas.
   *
   * @throws RendererError with words for the user: no WebGL2, a missing ability, a refused shader, too many objects.
   */
  static async create(
    canvas: HTMLCanvasElement,
    assets: SceneAssets,
    options: Partial<RendererOptions> = {},
  ): Promise<Renderer> {
    return new Renderer(canvas, assets, { ...DEFAULT_OPTIONS, ...options })
  }

  private constructor(canvas: HTMLCanvasElement, assets: SceneAssets, options: RendererOptions) {
    if (assets.objects.length > MAX_OBJECTS) {
      throw new RendererError(
        `The scene has ${assets.objects.length} virtual objects; this renderer draws at most ${MAX_OBJECTS}.`,
      )
    }
    this.#canvas = canvas
    this.#assets = assets
    this.#options = options
    this.#judgedExposure = options.exposure
    this.#poses = assets.objects.map((object) => fromRowMajor(object.worldFromObject))
    this.#weights = Float32Array.from(assets.lights, (light) => light.weight)
    this.#objectSh = new Float32Array(27 * assets.objects.length)
    this.#device = openDevice(canvas)
    this.#gpu = new GpuState(this.#device, assets)
    this.#size = { width: canvas.width, height: canvas.height }
    canvas.addEventListener('webglcontextlost', this.#onLost)
    canvas.addEventListener('webglcontextrestored', this.#onRestored)
  }

  /** Light to show; the arrays are copied. */
  setLight(frame: LightFrame): void {
    this.#vals.set(frame.vals.subarray(0, this.#vals.length))
    this.#valCount = Math.min(frame.count, MAX_VALS)
    this.#objectSh = frame.objectSh.slice()
    frame.changedSlots.forEach((changed, slot) => {
      if (changed) this.#changedSlots[slot] = 1
    })
    this.#runner.touch('light')
  }

  setCamera(camera: CameraChoice): void {
    if (camera.kind === 'tablet' && !this.#assets.views[camera.viewIndex]) {
      throw new RendererError(
        `View ${camera.viewIndex} does not exist; the scene has ${this.#assets.views.length}.`,
      )
    }
    this.#camera =
      camera.kind === 'tablet'
        ? { ...camera }
        : { ...camera, worldFromCamera: { elements: Float32Array.from(camera.worldFromCamera.elements) } }
    this.#runner.touch('camera')
  }

  setObjectPose(objectIndex: number, worldFromObject: MatrixLike): void {
    const pose = this.#poses[objectIndex]
    if (!pose) {
      throw new RangeError(`object ${objectIndex}: expected 0 to ${this.#poses.length - 1}`)
    }
    const next = Float32Array.from(worldFromObject.elements)
    if (next.every((value, i) => value === pose[i])) return
    this.#poses[objectIndex] = next
    this.#objectsMoved = true
    this.#runner.touch('poses')
  }

  /** Weight of every lamp in the background pictures. */
  setLightWeights(weights: Float32Array): void {
    if (weights.every((value, i) => value === this.#weights[i]) && weights.length === this.#weights.length) {
      return
    }
    this.#weights = weights.slice()
    this.#runner.touch('weights')
  }

  /** Streamed radiance of the room, for cameras without pictures. */
  updateAtlas(tiles: AtlasTiles): void {
    this.#atlas.update(tiles, this.#gpu)
    this.#runner.touch('atlas')
  }

  setOptions(partial: Partial<RendererOptions>): void {
    for (const [name, value] of Object.entries(partial) as [keyof RendererOptions, never][]) {
      if (value !== undefined && this.#options[name] !== value) {
        this.#options[name] = value
        this.#runner.touch(OPTION_KEYS[name])
        if (name === 'fullQuality') {
          this.#maps.invalidate()
        }
        if (name === 'exposure') this.#judgeExposure()
      }
    }
  }

  #judgeExposure(): void {
    const change = this.#options.exposure / this.#judgedExposure
    if (change > EXPOSURE_SLACK || change < 1 / EXPOSURE_SLACK ** 3) {
      this.#judgedExposure = this.#options.exposure
      this.#runner.touch('negligible light')
    }
  }

  /** Size of the picture, also of the canvas, pixels. */
  setSize(width: number, height: number): void {
    if (width === this.#size.width && height === this.#size.height) return
    this.#size = { width, height }
    this.#canvas.width = width
    this.#canvas.height = height
    this.#runner.touch('size')
  }

  /** Shades something else than the composite; for tests of its definition. */
  setShadingMode(mode: ShadingMode): void {
    this.#mode = mode
    this.#runner.touch('shading options')
  }

  /** Draws what changed. */
  render(nowMs: number): FrameStats {
    const start = performance.now()
    const runner = this.#runner
    runner.beginFrame()
    if (this.#lost || !Number.isFinite(nowMs)) {
      return { passes: [], cpuMs: 0, pending: this.#lost }
    }
    resetState(this.#device.gl)
    const { width, height } = this.#size
    const targets = this.#gpu.sized(width, height)
    const camera = this.#cameraState()
    this.#lightObjects()
    const frame = this.#frame(camera)
    this.#drawInputs(frame, targets)
    this.#shade(frame, targets)
    return {
      passes: runner.reports,
      cpuMs: performance.now() - start,
      pending: this.#options.shadows && this.#maps.pending,
    }
  }

  #frame(camera: CameraState): Frame {
    return {
      camera,
      options: this.#options,
      objects: this.#objects,
      valData: this.#gpu.valData,
      objectData: this.#gpu.objectData,
      valCount: this.#valCount,
    }
  }

  #lightObjects(): void {
    this.#runner.run('object light', ['light', 'poses'], ['object light'], () => {
      const light = { vals: this.#vals, count: this.#valCount, objectSh: this.#objectSh }
      this.#objects = this.#assets.objects.map((asset, index) =>
        lightObject(asset, index, this.#poses[index] as Float32Array, light, this.#assets.roomTriangles),
      )
      const spheres = this.#objects.map((object) => ({
        centre: worldCentre(object),
        radius: object.asset.radius,
      }))
      this.#maps.update(this.#vals, this.#valCount, this.#changedSlots, spheres, this.#objectsMoved)
      this.#changedSlots.fill(0)
      this.#objectsMoved = false
    })
  }

  /** Background, shadow maps, uploads, G-buffer, tiles. */
  #drawInputs(frame: Frame, targets: SizedTargets): void {
    const runner = this.#runner
    const gpu = this.#gpu
    if (frame.camera.hasPicture) {
      runner.run('background', ['size', 'camera', 'weights'], ['background'], () =>
        gpu.background.run(targets.background, frame.camera.viewIndex, this.#weights),
      )
    } else {
      runner.run('room', ['size', 'camera', 'atlas'], ['background'], () =>
        gpu.room(targets.width, targets.height).run(frame, gpu.meshes, gpu.atlas),
      )
    }
    if (!this.#options.shadows) {
      runner.skip('shadow maps', 'switched off')
    } else if (this.#maps.pending) {
      runner.touch('quality')
      runner.run('shadow maps', ['quality'], ['shadow maps'], () => {
        const limit = this.#options.fullQuality ? MAX_VALS : LIVE_MAPS_PER_FRAME
        const work = this.#maps.take(limit)
        this.#shadowPass().run(work, (slot) => this.#maps.position(slot), this.#maps.drawn, frame, gpu.meshes)
      })
    } else {
      runner.idle('shadow maps')
    }
    runner.run('light data', ['object light', 'shadow maps'], ['light data'], () => {
      gpu.valData.upload(
        packVals(
          this.#vals,
          this.#valCount,
          this.#maps.drawn,
          this.#objects.map((object) => object.openShare),
        ),
      )
      gpu.objectData.upload(packObjects(this.#objects, gpu.shade.slabStarts))
    })
    runner.run('gbuffer', ['size', 'camera', 'object light'], ['gbuffer'], () =>
      gpu.gbuffer.run(targets.gbuffer, frame, gpu.meshes),
    )
    const negligible = this.#options.fullQuality ? 0 : NEGLIGIBLE / this.#judgedExposure
    if (this.#usesTiles) {
      runner.run(
        'tiles',
        ['gbuffer', 'light data', 'shadow option', 'quality', 'negligible light'],
        ['tiles'],
        () => gpu.tiles.run(targets.tiles, frame, targets.gbuffer, negligible),
      )
    } else {
      runner.skip('tiles', 'switched off')
    }
  }

  /** Change, edges, display. */
  #shade(frame: Frame, targets: SizedTargets): void {
    const runner = this.#runner
    const gpu = this.#gpu
    const { antiAliasing } = this.#options
    const inputs: Key[] = [
      'gbuffer',
      'tiles',
      'light data',
      'shading options',
      'shadow option',
      'quality',
      'edges',
    ]
    const background = this.#background(frame.camera)
    runner.run('shade', this.#options.receiverRatio ? [...inputs, 'background'] : inputs, ['change'], () => {
      const { gbuffer, tiles } = targets
      const shading = {
        gbuffer,
        tiles,
        isTiled: this.#usesTiles,
        shadows: this.#shadowPass(),
        background,
        faint: FAINT / this.#judgedExposure,
      }
      gpu.shade.run(targets.change, targets.shares, frame, shading, this.#mode)
    })
    if (antiAliasing) {
      runner.run('coverage', ['size', 'camera', 'poses'], ['coverage'], () =>
        targets.coverage.run(frame, gpu.meshes),
      )
      runner.run('resolve', ['change', 'coverage', 'edges'], ['resolved'], () =>
        gpu.resolve.run(
          targets.change,
          targets.scratch,
          targets.coverage.resolved,
          this.#usesTiles ? targets.tiles : null,
        ),
      )
    } else {
      runner.skip('coverage', 'switched off')
      runner.skip('resolve', 'switched off')
    }
    runner.run('display', ['background', 'change', 'resolved', 'display options'], [], () =>
      gpu.display.run(frame, background, targets.change, targets.gbuffer, this.#backgroundShare),
    )
  }

  get #usesTiles(): boolean {
    const { tiled, receiverRatio } = this.#options
    return tiled && !receiverRatio && this.#mode === 'composite'
  }

  get #backgroundShare(): number {
    return this.#mode === 'composite' ? 1 : 0
  }

  #background(camera: CameraState): Target {
    const { width, height } = this.#size
    return camera.hasPicture
      ? this.#gpu.sized(width, height).background
      : this.#gpu.room(width, height).resolved
  }

  #shadowPass(): ReturnType<GpuState['shadows']> {
    return this.#gpu.shadows(this.#options.fullQuality ? 'full' : 'live')
  }

  #cameraState(): CameraState {
    const camera = this.#camera
    const { width, height } = this.#size
    const view = camera.kind === 'tablet' ? this.#assets.views[camera.viewIndex] : undefined
    const lens: Lens = view
      ? resizeLens(view, width, height)
      : centredLens(width, height, camera.kind === 'free' ? camera.verticalFov : Math.PI / 3)
    const worldFromCamera = view
      ? fromRowMajor(view.worldFromCamera)
      : Float32Array.from(camera.kind === 'free' ? camera.worldFromCamera.elements : [])
    return {
      kind: camera.kind,
      viewIndex: camera.kind === 'tablet' ? camera.viewIndex : -1,
      lens,
      worldFromCamera,
      clipFromWorld: clipFromWorld(lens, worldFromCamera),
      hasPicture: (view?.pictures.length ?? 0) > 0,
    }
  }

  /** Linear radiance RGBA of the last frame, row 0 on top; alpha = coverage by virtual objects. */
  readComposite(): Float32Array {
    const { gl } = this.#device
    const { width, height } = this.#size
    const targets = this.#gpu.sized(width, height)
    resetState(gl)
    this.#gpu.composite.run(
      targets.scratch,
      this.#background(this.#cameraState()),
      targets.change,
      this.#backgroundShare,
    )
    const pixels = new Float32Array(4 * width * height)
    gl.bindFramebuffer(gl.FRAMEBUFFER, targets.scratch.framebuffer)
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, pixels)
    const rowLength = 4 * width
    const swap = new Float32Array(rowLength)
    for (let top = 0, bottom = height - 1; top < bottom; top++, bottom--) {
      swap.set(pixels.subarray(top * rowLength, (top + 1) * rowLength))
      pixels.copyWithin(top * rowLength, bottom * rowLength, (bottom + 1) * rowLength)
      pixels.set(swap, bottom * rowLength)
    }
    return pixels
  }

  /** Nearest surface under a point of the picture (-1 to 1, y up), or null. */
  pick(xNdc: number, yNdc: number): PickedSurface | null {
    const camera = this.#cameraState()
    const found = pickSurface(
      {
        room: this.#assets.roomTriangles,
        objects: this.#assets.objects.map((mesh, index) => ({
          mesh,
          worldFromObject: this.#poses[index] as Float32Array,
        })),
      },
      camera.lens,
      camera.worldFromCamera,
      xNdc,
      yNdc,
    )
    return (
      found && {
        objectIndex: found.objectIndex,
        positionWorld: new Vector3(...found.positionWorld),
        normalWorld: new Vector3(...found.normalWorld),
      }
    )
  }

  readonly #onLost = (event: Event): void => {
    // Without this the browser never gives the context back.
    event.preventDefault()
    this.#lost = true
  }

  readonly #onRestored = (): void => {
    this.#device = probeDevice(this.#device.gl)
    this.#gpu = new GpuState(this.#device, this.#assets)
    this.#lost = false
    this.#runner.reset()
    this.#maps.invalidate()
    this.#atlas.restore(this.#gpu)
  }

  dispose(): void {
    this.#canvas.removeEventListener('webglcontextlost', this.#onLost)
    this.#canvas.removeEventListener('webglcontextrestored', this.#onRestored)
    this.#gpu.dispose()
  }
}

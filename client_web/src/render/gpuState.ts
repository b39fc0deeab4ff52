/** Everything that lives in one WebGL context; made anew when a lost context comes back. */
import { MAX_VALS } from '../radiometry/valLight'
import type { Device } from './device'
import { DataTexture, makeTexture, Target } from './gl/targets'
import { VAL_COLUMNS } from './lightData'
import { MAX_OBJECTS, OBJECT_COLUMNS } from './objectData'
import { BackgroundPass } from './passes/backgroundPass'
import { CompositePass } from './passes/compositePass'
import { CoveragePass } from './passes/coveragePass'
import { DisplayPass } from './passes/displayPass'
import { GbufferPass } from './passes/gbufferPass'
import { ResolvePass } from './passes/resolvePass'
import { RoomPass } from './passes/roomPass'
import { ShadePass } from './passes/shadePass'
import { ShadowPass } from './passes/shadowPass'
import { TilePass } from './passes/tilePass'
import { SceneMeshes } from './sceneMeshes'
import type { SceneAssets } from './types'

/** Texels per side of a shadow map. */
const MAP_SIZE = { live: 128, full: 256 } as const

/** Targets that depend on the size of the picture. */
export interface SizedTargets {
  readonly width: number
  readonly height: number
  readonly gbuffer: Target
  readonly background: Target
  readonly tiles: Target
  /** What virtual objects change: shade.frag, resolve.frag. */
  readonly change: Target
  /** Before it is gathered: what each fragment found itself, and its share of the VALs. */
  readonly shares: Target
  /** Silhouettes on their way, or the composite when it is read back. */
  readonly scratch: Target
  readonly coverage: CoveragePass
}

export class GpuState {
  readonly meshes: SceneMeshes
  readonly background: BackgroundPass
  readonly gbuffer: GbufferPass
  readonly tiles: TilePass
  readonly shade: ShadePass
  readonly resolve: ResolvePass
  readonly composite: CompositePass
  readonly display: DisplayPass
  readonly valData: DataTexture
  readonly objectData: DataTexture
  readonly #device: Device
  readonly #shadows = new Map<'live' | 'full', ShadowPass>()
  #sized: SizedTargets | null = null
  #room: RoomPass | null = null
  #atlas: { texture: WebGLTexture; width: number; height: number } | null = null

  constructor(device: Device, assets: SceneAssets) {
    const { gl } = device
    this.#device = device
    this.meshes = new SceneMeshes(gl, assets)
    this.background = new BackgroundPass(gl, assets.views, assets.lights)
    this.gbuffer = new GbufferPass(gl)
    this.tiles = new TilePass(gl)
    this.shade = new ShadePass(gl, assets.objects)
    this.resolve = new ResolvePass(gl)
    this.composite = new CompositePass(gl)
    this.display = new DisplayPass(gl)
    this.valData = new DataTexture(gl, VAL_COLUMNS, MAX_VALS)
    this.objectData = new DataTexture(gl, OBJECT_COLUMNS, MAX_OBJECTS)
  }

  shadows(quality: 'live' | 'full'): ShadowPass {
    let pass = this.#shadows.get(quality)
    if (!pass) {
      pass = new ShadowPass(this.#device.gl, MAP_SIZE[quality])
      this.#shadows.set(quality, pass)
    }
    return pass
  }

  sized(width: number, height: number): SizedTargets {
    if (this.#sized && this.#sized.width === width && this.#sized.height === height) {
      return this.#sized
    }
    this.#disposeSized()
    const { gl, radianceFormat } = this.#device
    const radiance = (name: string): Target => new Target(gl, name, width, height, [radianceFormat])
    this.#sized = {
      width,
      height,
      gbuffer: this.gbuffer.makeTarget(width, height),
      background: radiance('background'),
      tiles: this.tiles.makeTarget(width, height),
      change: radiance('change'),
      shares: new Target(gl, 'shares', width, height, [gl.RGBA16F, gl.RGBA16F]),
      scratch: radiance('scratch'),
      coverage: new CoveragePass(gl, width, height),
    }
    return this.#sized
  }

  /** Made when first needed: cameras with pictures do without its memory. */
  room(width: number, height: number): RoomPass {
    this.#room ??= new RoomPass(this.#device.gl, width, height)
    return this.#room
  }

  get atlas(): WebGLTexture | null {
    return this.#atlas?.texture ?? null
  }

  /** Writes one square of the streamed room radiance, RGB9_E5, row 0 first. */
  writeAtlas(width: number, height: number, x: number, y: number, side: number, texels: Uint32Array): void {
    const { gl } = this.#device
    if (this.#atlas?.width !== width || this.#atlas.height !== height) {
      gl.deleteTexture(this.atlas)
      this.#atlas = { texture: makeTexture(gl, gl.RGB9_E5, width, height, gl.LINEAR), width, height }
    }
    gl.activeTexture(gl.TEXTURE0)
    gl.bindTexture(gl.TEXTURE_2D, this.atlas)
    gl.texSubImage2D(gl.TEXTURE_2D, 0, x, y, side, side, gl.RGB, gl.UNSIGNED_INT_5_9_9_9_REV, texels)
  }

  #disposeSized(): void {
    const sized = this.#sized
    if (!sized) return
    for (const part of [
      sized.gbuffer,
      sized.background,
      sized.tiles,
      sized.change,
      sized.shares,
      sized.scratch,
      sized.coverage,
    ]) {
      part.dispose()
    }
    this.#sized = null
    this.#room?.dispose()
    this.#room = null
  }

  dispose(): void {
    this.#disposeSized()
    for (const part of [
      this.meshes,
      this.background,
      this.gbuffer,
      this.tiles,
      this.shade,
      this.resolve,
      this.composite,
      this.display,
      this.valData,
      this.objectData,
      ...this.#shadows.values(),
    ]) {
      part.dispose()
    }
    this.#device.gl.deleteTexture(this.atlas)
  }
}

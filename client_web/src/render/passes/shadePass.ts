import { NEAR } from '../camera'
import { drawScreen } from '../device'
import { Program } from '../gl/program'
import { setSampling, type Target } from '../gl/targets'
import { SHADERS } from '../glsl'
import { stackFields } from '../objectData'
import { SHADOW_NEAR } from '../shadowFit'
import type { ObjectAsset } from '../types'
import { type Frame, lensUniform } from './frame'
import { type ShadowPass, TILES_PER_SIDE } from './shadowPass'

/** What is shaded: the composite, or one of the two pictures that its definition is tested against. */
export const SHADING_MODES = { composite: 0, room: 1, augmented: 2 } as const
export type ShadingMode = keyof typeof SHADING_MODES

const TAPS = { live: { search: 12, filter: 16 }, full: { search: 48, filter: 96 } } as const

/** Rohmer et al. 2014, Eq. 12 and 13, with soft shadows and the indirect exchange. Inputs: all of the former passes. */
export class ShadePass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program
  readonly #fields: readonly WebGLTexture[]
  readonly #fieldSize: readonly [number, number, number]
  /** First cell along z of every object's occlusion field. */
  readonly slabStarts: readonly number[]

  constructor(gl: WebGL2RenderingContext, objects: readonly ObjectAsset[]) {
    this.#gl = gl
    this.#program = new Program(gl, 'shading', SHADERS.shade)
    const stacked = stackFields(objects)
    this.#fieldSize = stacked.size
    this.slabStarts = stacked.slabStarts
    this.#fields = stacked.layers.map((layer) => {
      const texture = gl.createTexture()
      gl.activeTexture(gl.TEXTURE0)
      gl.bindTexture(gl.TEXTURE_3D, texture)
      gl.texStorage3D(gl.TEXTURE_3D, 1, gl.RGBA16F, ...stacked.size)
      setSampling(gl, gl.TEXTURE_3D, gl.LINEAR)
      gl.texSubImage3D(gl.TEXTURE_3D, 0, 0, 0, 0, ...stacked.size, gl.RGBA, gl.HALF_FLOAT, layer)
      return texture
    })
  }

  run(
    target: Target,
    frame: Frame,
    gbuffer: Target,
    background: Target,
    tiles: Target,
    shadows: ShadowPass,
    mode: ShadingMode,
  ): void {
    const gl = this.#gl
    const field = (i: number): { target: number; texture: WebGLTexture | null } => ({
      target: gl.TEXTURE_3D,
      texture: this.#fields[i] ?? null,
    })
    const taps = frame.options.fullQuality ? TAPS.full : TAPS.live
    target.bind()
    this.#program
      .use()
      .textures({
        uAlbedo: gbuffer.colour(0),
        uNormal: gbuffer.colour(1),
        uIndirect: gbuffer.colour(2),
        uDepth: gbuffer.depthTexture(),
        uBackground: background.colour(),
        uTileMask: tiles.colour(),
        uValData: frame.valData.binding(),
        uObjectData: frame.objectData.binding(),
        ...shadows.bindings(),
        uOcclusion0: field(0),
        uOcclusion1: field(1),
        uOcclusion2: field(2),
      })
      .int('uTiled', frame.options.tiled && mode === 'composite')
      .int('uNumVals', frame.valCount)
      .int('uNumObjects', frame.objects.length)
      .int('uShadows', frame.options.shadows)
      .int('uIndirectExchange', frame.options.indirectOcclusion)
      .int('uFixtureRays', frame.options.fixtureRays)
      .int('uRoomShadows', frame.options.roomShadows)
      .int('uReceiverRatio', frame.options.receiverRatio)
      .int('uMode', SHADING_MODES[mode])
      .int('uSearchTaps', taps.search)
      .int('uFilterTaps', taps.filter)
      .float('uShadowNear', SHADOW_NEAR)
      .float('uShadowLayout', TILES_PER_SIDE, shadows.tileSize)
      .float('uOcclusionSize', ...this.#fieldSize)
      .mat4('uWorldFromCamera', frame.camera.worldFromCamera)
      .float('uLens', ...lensUniform(frame.camera.lens))
      .float('uNear', NEAR)
    drawScreen(gl)
  }

  dispose(): void {
    this.#program.dispose()
    for (const texture of this.#fields) {
      this.#gl.deleteTexture(texture)
    }
  }
}

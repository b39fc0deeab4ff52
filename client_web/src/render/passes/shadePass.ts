import { NEAR } from '../camera'
import { drawScreen } from '../device'
import { Program, type TextureBinding } from '../gl/program'
import { setSampling, type Target } from '../gl/targets'
import { drawTiles } from '../gl/tilePoints'
import { SHADERS, type ShaderSource } from '../glsl'
import { stackFields } from '../objectData'
import { SHADOW_NEAR } from '../shadowFit'
import { makeTaps } from '../shadowTaps'
import type { ObjectAsset } from '../types'
import { type Frame, lensUniform } from './frame'
import { type ShadowPass, TILES_PER_SIDE } from './shadowPass'
import { TILE_KINDS } from './tilePass'

/** What is shaded: the composite, or one of the two pictures that its definition is tested against. */
export const SHADING_MODES = { composite: 0, room: 1, augmented: 2 } as const
export type ShadingMode = keyof typeof SHADING_MODES

const TAPS = { live: makeTaps(8, 8), full: makeTaps(48, 96) } as const

export interface ShadeInputs {
  readonly gbuffer: Target
  readonly tiles: Target
  readonly isTiled: boolean
  readonly shadows: ShadowPass
  /** Radiance of a VAL below which half of the taps do, live only; W/(sr m^2). */
  readonly faint: number
  /** Read for `receiverRatio` only. */
  readonly background: Target
}

interface KindProgram {
  readonly kind: number
  readonly source: ShaderSource
}

/** One program per kind of tile, so that none carries what its tiles do not need. */
const EXACT: readonly KindProgram[] = [
  { kind: TILE_KINDS.exchangeOnly, source: SHADERS.shadeExchangeOnly },
  { kind: TILE_KINDS.real, source: SHADERS.shadeReal },
  { kind: TILE_KINDS.mixed, source: SHADERS.shadeMixed },
]
const INTERLEAVED: readonly KindProgram[] = [
  { kind: TILE_KINDS.exchangeOnly, source: SHADERS.interleaveExchangeOnly },
  { kind: TILE_KINDS.real, source: SHADERS.interleaveReal },
  { kind: TILE_KINDS.mixed, source: SHADERS.interleaveMixed },
]

/**
 * What virtual objects change in the picture: Rohmer et al. 2014, Eq. 12 and 13, with soft shadows and the indirect exchange.
 * Inputs: G-buffer, tiles, VALs, shadow maps. Tiles that no object reaches are not drawn at all. While the picture is live, fragments
 * share the VALs out among themselves (shade.frag); in full quality each takes all of them.
 */
export class ShadePass {
  readonly #gl: WebGL2RenderingContext
  readonly #programs = new Map<ShaderSource, Program>()
  readonly #fields: readonly WebGLTexture[]
  readonly #fieldSize: readonly [number, number, number]
  /** First cell along z of every object's occlusion field. */
  readonly slabStarts: readonly number[]

  constructor(gl: WebGL2RenderingContext, objects: readonly ObjectAsset[]) {
    this.#gl = gl
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

  /** @param shares where interleaved fragments leave their own part and their share of the VALs. */
  run(target: Target, shares: Target, frame: Frame, inputs: ShadeInputs, mode: ShadingMode): void {
    const gl = this.#gl
    const { gbuffer, tiles } = inputs
    const prepare = (source: ShaderSource): Program =>
      this.#prepare(this.#program(source), frame, inputs).int('uMode', SHADING_MODES[mode])
    if (!inputs.isTiled) {
      target.bind()
      prepare(frame.options.receiverRatio ? SHADERS.shadeReceiverRatio : SHADERS.shade).int('uTiled', false)
      drawScreen(gl)
      return
    }
    const isInterleaved = !frame.options.fullQuality
    this.#clear(target)
    if (isInterleaved) this.#clear(shares)
    for (const { kind, source } of isInterleaved ? INTERLEAVED : EXACT) {
      if (kind === TILE_KINDS.exchangeOnly && !frame.options.indirectOcclusion) continue
      const program = prepare(source).int('uTiled', true)
      this.#drawKinds(program, [kind], tiles, target)
    }
    if (isInterleaved) {
      target.bind()
      const program = this.#program(SHADERS.gather)
        .use()
        .textures({
          uChange: shares.colour(0),
          uShare: shares.colour(1),
          uAlbedo: gbuffer.colour(0),
          uTileLights: tiles.colour(0),
        })
      this.#drawKinds(program, Object.values(TILE_KINDS), tiles, target)
    }
  }

  #clear(target: Target): void {
    target.bind()
    target.colours.forEach((_, i) => {
      this.#gl.clearBufferfv(this.#gl.COLOR, i, [0, 0, 0, 0])
    })
  }

  #drawKinds(program: Program, kinds: readonly number[], tiles: Target, target: Target): void {
    program.int2('uTiles', tiles.width, tiles.height).uint(
      'uWantedKinds',
      kinds.reduce((bits, kind) => bits | (1 << kind), 0),
    )
    drawTiles(this.#gl, target.width, target.height)
  }

  /** Compiled when first needed: live pictures and evaluation use different ones. */
  #program(source: ShaderSource): Program {
    let program = this.#programs.get(source)
    if (!program) {
      program = new Program(this.#gl, 'shading', source)
      this.#programs.set(source, program)
    }
    return program
  }

  #prepare(program: Program, frame: Frame, inputs: ShadeInputs): Program {
    const { gbuffer, tiles, shadows } = inputs
    const { TEXTURE_3D } = this.#gl
    const field = (i: number): TextureBinding => ({ target: TEXTURE_3D, texture: this.#fields[i] ?? null })
    const taps = frame.options.fullQuality ? TAPS.full : TAPS.live
    return program
      .use()
      .textures({
        uAlbedo: gbuffer.colour(0),
        uNormal: gbuffer.colour(1),
        uIndirect: gbuffer.colour(2),
        uDepth: gbuffer.depthTexture(),
        uTileLights: tiles.colour(0),
        uValData: frame.valData.binding(),
        uObjectData: frame.objectData.binding(),
        ...shadows.bindings(),
        uOcclusion0: field(0),
        uOcclusion1: field(1),
        uOcclusion2: field(2),
        ...(frame.options.receiverRatio ? { uBackground: inputs.background.colour() } : {}),
      })
      .int('uNumVals', frame.valCount)
      .int('uNumObjects', frame.objects.length)
      .int('uShadows', frame.options.shadows)
      .int('uIndirectExchange', frame.options.indirectOcclusion)
      .int('uFixtureRays', frame.options.fixtureRays)
      .int('uRoomShadows', frame.options.roomShadows)
      .int('uSearchTaps', taps.numSearch)
      .int('uFilterTaps', taps.numFilter)
      .int('uAdaptive', !frame.options.fullQuality)
      .vec4Array('uSearchPoints', taps.search)
      .vec2Array('uFilterPoints', taps.filter)
      .float('uFaint', inputs.faint)
      .float('uShadowNear', SHADOW_NEAR)
      .float('uShadowLayout', TILES_PER_SIDE, shadows.tileSize)
      .float('uOcclusionSize', ...this.#fieldSize)
      .mat4('uWorldFromCamera', frame.camera.worldFromCamera)
      .float('uLens', ...lensUniform(frame.camera.lens))
      .float('uNear', NEAR)
  }

  dispose(): void {
    for (const program of this.#programs.values()) {
      program.dispose()
    }
    for (const texture of this.#fields) {
      this.#gl.deleteTexture(texture)
    }
  }
}

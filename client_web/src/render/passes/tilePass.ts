import { NEAR } from '../camera'
import { drawScreen } from '../device'
import { Program } from '../gl/program'
import { Target } from '../gl/targets'
import { tilesAcross } from '../gl/tilePoints'
import { SHADERS } from '../glsl'
import { SHADOW_NEAR } from '../shadowFit'
import { type Frame, lensUniform } from './frame'
import { type ShadowPass, TILES_PER_SIDE } from './shadowPass'

/** Kinds of tiles, as written by shaders/tiles.frag; 0 = virtual objects change nothing there. */
export const TILE_KINDS = { exchangeOnly: 1, real: 2, mixed: 3 } as const

/**
 * Per tile, the VALs that can matter there and those whose shadows must be sampled (after Rohmer et al. 2014, section 5, who test
 * hemispheres only), and what kind of tile it is. Inputs: G-buffer, VALs, objects, bounds of the shadow maps.
 */
export class TilePass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program

  constructor(gl: WebGL2RenderingContext) {
    this.#gl = gl
    this.#program = new Program(gl, 'tiles', SHADERS.tiles)
  }

  makeTarget(width: number, height: number): Target {
    const { RGBA32UI } = this.#gl
    return new Target(this.#gl, 'tiles', tilesAcross(width), tilesAcross(height), [RGBA32UI, RGBA32UI])
  }

  /** @param budget radiance that may be left out of a tile in all, W/(sr m^2). */
  run(target: Target, frame: Frame, gbuffer: Target, shadows: ShadowPass, budget: number): void {
    target.bind()
    this.#program
      .use()
      .textures({
        uAlbedo: gbuffer.colour(0),
        uNormal: gbuffer.colour(1),
        uDepth: gbuffer.depthTexture(),
        uValData: frame.valData.binding(),
        uObjectData: frame.objectData.binding(),
        ...shadows.boundsBindings(),
      })
      .int2('uSize', gbuffer.width, gbuffer.height)
      .int('uNumVals', frame.valCount)
      .int('uNumObjects', frame.objects.length)
      .int('uShadows', frame.options.shadows)
      .float('uBudget', budget)
      .float('uShadowNear', SHADOW_NEAR)
      .float('uShadowLayout', TILES_PER_SIDE, shadows.tileSize)
      .mat4('uWorldFromCamera', frame.camera.worldFromCamera)
      .float('uLens', ...lensUniform(frame.camera.lens))
      .float('uNear', NEAR)
    drawScreen(this.#gl)
  }

  dispose(): void {
    this.#program.dispose()
  }
}

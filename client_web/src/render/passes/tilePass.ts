import { NEAR } from '../camera'
import { drawScreen } from '../device'
import { Program } from '../gl/program'
import { Target } from '../gl/targets'
import { tilesAcross } from '../gl/tilePoints'
import { SHADERS } from '../glsl'
import { type Frame, lensUniform } from './frame'

/** Kinds of tiles, as written by shaders/tiles.frag; 0 = virtual objects change nothing there. */
export const TILE_KINDS = { exchangeOnly: 1, real: 2, mixed: 3 } as const

/**
 * Per tile, the VALs that can matter there (after Rohmer et al. 2014, section 5, who test hemispheres only), and what kind of tile it
 * is. Inputs: G-buffer, VALs, objects.
 */
export class TilePass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program

  constructor(gl: WebGL2RenderingContext) {
    this.#gl = gl
    this.#program = new Program(gl, 'tiles', SHADERS.tiles)
  }

  makeTarget(width: number, height: number): Target {
    return new Target(this.#gl, 'tiles', tilesAcross(width), tilesAcross(height), [this.#gl.RGBA32UI])
  }

  /** @param budget radiance that may be left out of a tile in all, W/(sr m^2). */
  run(target: Target, frame: Frame, gbuffer: Target, budget: number): void {
    target.bind()
    this.#program
      .use()
      .textures({
        uAlbedo: gbuffer.colour(0),
        uNormal: gbuffer.colour(1),
        uDepth: gbuffer.depthTexture(),
        uValData: frame.valData.binding(),
        uObjectData: frame.objectData.binding(),
      })
      .int2('uSize', gbuffer.width, gbuffer.height)
      .int('uNumVals', frame.valCount)
      .int('uNumObjects', frame.objects.length)
      .int('uShadows', frame.options.shadows)
      .float('uBudget', budget)
      .mat4('uWorldFromCamera', frame.camera.worldFromCamera)
      .float('uLens', ...lensUniform(frame.camera.lens))
      .float('uNear', NEAR)
    drawScreen(this.#gl)
  }

  dispose(): void {
    this.#program.dispose()
  }
}

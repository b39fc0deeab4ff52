import { NEAR } from '../camera'
import { drawScreen } from '../device'
import { Program } from '../gl/program'
import { Target } from '../gl/targets'
import { SHADERS } from '../glsl'
import { type Frame, lensUniform } from './frame'

/** Fragments per side of a tile. */
export const TILE_SIZE = 8

/** A bit mask per tile of the VALs that can matter there (Rohmer et al. 2014, section 5). Inputs: G-buffer, VALs, objects. */
export class TilePass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program

  constructor(gl: WebGL2RenderingContext) {
    this.#gl = gl
    this.#program = new Program(gl, 'tiles', SHADERS.tiles)
  }

  makeTarget(width: number, height: number): Target {
    const tiles = (size: number): number => Math.ceil(size / TILE_SIZE)
    return new Target(this.#gl, 'tiles', tiles(width), tiles(height), [this.#gl.RGBA32UI])
  }

  run(target: Target, frame: Frame, gbuffer: Target): void {
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
      .mat4('uWorldFromCamera', frame.camera.worldFromCamera)
      .float('uLens', ...lensUniform(frame.camera.lens))
      .float('uNear', NEAR)
    drawScreen(this.#gl)
  }

  dispose(): void {
    this.#program.dispose()
  }
}

import { drawScreen } from '../device'
import { Program } from '../gl/program'
import type { Target } from '../gl/targets'
import { SHADERS } from '../glsl'

/** Linear radiance of the whole picture, only for those who read it back. Inputs: background, change. */
export class CompositePass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program

  constructor(gl: WebGL2RenderingContext) {
    this.#gl = gl
    this.#program = new Program(gl, 'composite', SHADERS.composite)
  }

  /** @param backgroundShare 0 leaves the background out. */
  run(target: Target, background: Target, change: Target, backgroundShare: number): void {
    target.bind()
    this.#program
      .use()
      .textures({ uBackground: background.colour(), uChange: change.colour() })
      .float('uBackgroundShare', backgroundShare)
    drawScreen(this.#gl)
  }

  dispose(): void {
    this.#program.dispose()
  }
}

import { drawScreen } from '../device'
import { Program } from '../gl/program'
import type { Target } from '../gl/targets'
import { SHADERS } from '../glsl'
import type { Frame } from './frame'

/** Blends silhouettes by coverage, still linear. Inputs: composite, coverage, background. */
export class ResolvePass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program

  constructor(gl: WebGL2RenderingContext) {
    this.#gl = gl
    this.#program = new Program(gl, 'resolve', SHADERS.resolve)
  }

  run(target: Target, frame: Frame, composite: Target, coverage: Target, background: Target): void {
    target.bind()
    this.#program
      .use()
      .textures({
        uComposite: composite.colour(),
        uCoverageMap: coverage.colour(),
        uBackground: background.colour(),
      })
      .int('uHasBackground', frame.camera.hasPicture)
    drawScreen(this.#gl)
  }

  dispose(): void {
    this.#program.dispose()
  }
}

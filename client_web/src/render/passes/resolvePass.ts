import { drawScreen } from '../device'
import { Program } from '../gl/program'
import type { Target } from '../gl/targets'
import { SHADERS } from '../glsl'

/** Blends silhouettes by coverage, still linear. Inputs: composite, coverage, background. */
export class ResolvePass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program

  constructor(gl: WebGL2RenderingContext) {
    this.#gl = gl
    this.#program = new Program(gl, 'resolve', SHADERS.resolve)
  }

  run(target: Target, composite: Target, coverage: Target, background: Target): void {
    target.bind()
    this.#program.use().textures({
      uComposite: composite.colour(),
      uCoverageMap: coverage.colour(),
      uBackground: background.colour(),
    })
    drawScreen(this.#gl)
  }

  dispose(): void {
    this.#program.dispose()
  }
}

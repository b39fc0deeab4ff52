import { drawScreen } from '../device'
import { Program } from '../gl/program'
import type { Target } from '../gl/targets'
import { drawTiles } from '../gl/tilePoints'
import { SHADERS, type ShaderSource } from '../glsl'

/**
 * Blends silhouettes by coverage, still linear, and in place. Inputs: change, coverage, tiles. Only tiles in which a virtual object can
 * end are drawn: into `scratch`, because fragments read their neighbours, and back.
 */
export class ResolvePass {
  readonly #gl: WebGL2RenderingContext
  readonly #tiled: readonly [Program, Program]
  readonly #everywhere: readonly [Program, Program]

  constructor(gl: WebGL2RenderingContext) {
    const make = (blend: ShaderSource, copy: ShaderSource): [Program, Program] => [
      new Program(gl, 'resolve', blend),
      new Program(gl, 'copy', copy),
    ]
    this.#gl = gl
    this.#tiled = make(SHADERS.resolveTiles, SHADERS.copyTiles)
    this.#everywhere = make(SHADERS.resolve, SHADERS.copy)
  }

  /** @param tiles null: silhouettes are looked for everywhere. */
  run(change: Target, scratch: Target, coverage: Target, tiles: Target | null): void {
    const gl = this.#gl
    const [blend, copy] = tiles ? this.#tiled : this.#everywhere
    const marks = tiles ? { uTileLights: tiles.colour() } : {}
    const draw = (target: Target, program: Program): void => {
      target.bind()
      if (tiles) {
        program.int2('uTiles', tiles.width, tiles.height)
        drawTiles(gl, target.width, target.height)
      } else {
        drawScreen(gl)
      }
    }
    draw(
      scratch,
      blend.use().textures({ uChange: change.colour(), uCoverageMap: coverage.colour(), ...marks }),
    )
    draw(change, copy.use().textures({ uSource: scratch.colour(), ...marks }))
  }

  dispose(): void {
    for (const program of [...this.#tiled, ...this.#everywhere]) {
      program.dispose()
    }
  }
}

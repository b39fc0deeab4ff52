import { MultisampleTarget } from '../gl/multisample'
import { Program } from '../gl/program'
import type { Target } from '../gl/targets'
import { SHADERS } from '../glsl'
import type { SceneMeshes } from '../sceneMeshes'
import { multiply4 } from '../vector'
import type { Frame } from './frame'

/** Share of every fragment that virtual objects cover, real surfaces in front taken off: 4 samples. Inputs: camera, poses. */
export class CoveragePass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program
  readonly #target: MultisampleTarget

  constructor(gl: WebGL2RenderingContext, width: number, height: number) {
    this.#gl = gl
    this.#program = new Program(gl, 'coverage', SHADERS.coverage)
    this.#target = new MultisampleTarget(gl, 'coverage', width, height, gl.R8)
  }

  get resolved(): Target {
    return this.#target.resolved
  }

  run(frame: Frame, meshes: SceneMeshes): void {
    const gl = this.#gl
    this.#target.begin()
    gl.enable(gl.DEPTH_TEST)
    gl.enable(gl.CULL_FACE)
    this.#program.use().mat4('uClipFromObject', frame.camera.clipFromWorld).float('uCoverage', 0)
    meshes.room.draw()
    gl.disable(gl.CULL_FACE)
    this.#program.float('uCoverage', 1)
    meshes.objects.forEach((mesh, index) => {
      const object = frame.objects[index]
      if (object) {
        this.#program.mat4('uClipFromObject', multiply4(frame.camera.clipFromWorld, object.worldFromObject))
        mesh.full.draw()
      }
    })
    gl.disable(gl.DEPTH_TEST)
    this.#target.resolve()
  }

  dispose(): void {
    this.#program.dispose()
    this.#target.dispose()
  }
}

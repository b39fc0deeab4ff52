import { MultisampleTarget } from '../gl/multisample'
import { Program } from '../gl/program'
import type { Target } from '../gl/targets'
import { SHADERS } from '../glsl'
import type { SceneMeshes } from '../sceneMeshes'
import type { Frame } from './frame'

/** The room as the server last measured it: the background of cameras without pictures, edges smooth. Inputs: camera, atlas. */
export class RoomPass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program
  readonly #target: MultisampleTarget

  constructor(gl: WebGL2RenderingContext, width: number, height: number) {
    this.#gl = gl
    this.#program = new Program(gl, 'room', SHADERS.room)
    this.#target = new MultisampleTarget(gl, 'room', width, height, gl.RGBA16F)
  }

  get resolved(): Target {
    return this.#target.resolved
  }

  run(frame: Frame, meshes: SceneMeshes, atlas: WebGLTexture | null): void {
    const gl = this.#gl
    this.#target.begin()
    if (atlas) {
      gl.enable(gl.DEPTH_TEST)
      // Surfaces are one-sided: a free camera outside the room looks in.
      gl.enable(gl.CULL_FACE)
      this.#program
        .use()
        .mat4('uClipFromWorld', frame.camera.clipFromWorld)
        .textures({ uAtlas: { target: gl.TEXTURE_2D, texture: atlas } })
      meshes.room.draw()
      gl.disable(gl.CULL_FACE)
      gl.disable(gl.DEPTH_TEST)
    }
    this.#target.resolve()
  }

  dispose(): void {
    this.#program.dispose()
    this.#target.dispose()
  }
}

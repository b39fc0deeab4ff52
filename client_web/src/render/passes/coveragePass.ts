import { RendererError } from '../errors'
import { Program } from '../gl/program'
import { Target } from '../gl/targets'
import { SHADERS } from '../glsl'
import type { SceneMeshes } from '../sceneMeshes'
import { multiply4 } from '../vector'
import type { Frame } from './frame'

/** Share of every fragment that virtual objects cover, real surfaces in front taken off: 4 samples. Inputs: camera, poses. */
export class CoveragePass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program
  readonly #framebuffer: WebGLFramebuffer
  readonly #buffers: readonly WebGLRenderbuffer[]
  readonly resolved: Target

  constructor(
    gl: WebGL2RenderingContext,
    readonly width: number,
    readonly height: number,
  ) {
    this.#gl = gl
    this.#program = new Program(gl, 'coverage', SHADERS.coverage)
    this.resolved = new Target(gl, 'coverage', width, height, [gl.R8])
    this.#framebuffer = gl.createFramebuffer()
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#framebuffer)
    const samples = Math.min(4, gl.getParameter(gl.MAX_SAMPLES) as number)
    this.#buffers = (
      [
        [gl.R8, gl.COLOR_ATTACHMENT0],
        [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT],
      ] as const
    ).map(([format, attachment]) => {
      const buffer = gl.createRenderbuffer()
      gl.bindRenderbuffer(gl.RENDERBUFFER, buffer)
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, format, width, height)
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment, gl.RENDERBUFFER, buffer)
      return buffer
    })
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE && !gl.isContextLost()) {
      throw new RendererError('This device cannot smooth edges; switch anti-aliasing off.')
    }
  }

  run(frame: Frame, meshes: SceneMeshes): void {
    const gl = this.#gl
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#framebuffer)
    gl.viewport(0, 0, this.width, this.height)
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0])
    gl.clearBufferfv(gl.DEPTH, 0, [1])
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
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.#framebuffer)
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, this.resolved.framebuffer)
    const { width, height } = this
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST)
  }

  dispose(): void {
    this.#program.dispose()
    this.resolved.dispose()
    this.#gl.deleteFramebuffer(this.#framebuffer)
    for (const buffer of this.#buffers) {
      this.#gl.deleteRenderbuffer(buffer)
    }
  }
}

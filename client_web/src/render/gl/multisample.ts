import { RendererError } from '../errors'
import { Target } from './targets'

/** One colour with depth, several samples per fragment, and what they average to. */
export class MultisampleTarget {
  readonly #gl: WebGL2RenderingContext
  readonly #framebuffer: WebGLFramebuffer
  readonly #buffers: readonly WebGLRenderbuffer[]
  /** The mean of the samples, after `resolve`. */
  readonly resolved: Target

  /** @throws RendererError when the device cannot render to this format. */
  constructor(
    gl: WebGL2RenderingContext,
    name: string,
    readonly width: number,
    readonly height: number,
    format: number,
  ) {
    this.#gl = gl
    this.resolved = new Target(gl, name, width, height, [format])
    this.#framebuffer = gl.createFramebuffer()
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#framebuffer)
    const samples = Math.min(4, mostSamples(gl, format), mostSamples(gl, gl.DEPTH_COMPONENT24))
    this.#buffers = (
      [
        [format, gl.COLOR_ATTACHMENT0],
        [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT],
      ] as const
    ).map(([internalFormat, attachment]) => {
      const buffer = gl.createRenderbuffer()
      gl.bindRenderbuffer(gl.RENDERBUFFER, buffer)
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, internalFormat, width, height)
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment, gl.RENDERBUFFER, buffer)
      return buffer
    })
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE && !gl.isContextLost()) {
      this.dispose()
      throw new RendererError(
        `This device cannot smooth edges (picture buffer "${name}"); switch anti-aliasing off.`,
      )
    }
  }

  /** Binds and clears to 0 and to the far plane. */
  begin(): void {
    const gl = this.#gl
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#framebuffer)
    gl.viewport(0, 0, this.width, this.height)
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0])
    gl.clearBufferfv(gl.DEPTH, 0, [1])
  }

  resolve(): void {
    const gl = this.#gl
    const { width, height } = this
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.#framebuffer)
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, this.resolved.framebuffer)
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST)
  }

  dispose(): void {
    this.resolved.dispose()
    this.#gl.deleteFramebuffer(this.#framebuffer)
    for (const buffer of this.#buffers) {
      this.#gl.deleteRenderbuffer(buffer)
    }
  }
}

/** Float formats may allow fewer samples than others, or none (0). */
function mostSamples(gl: WebGL2RenderingContext, format: number): number {
  const counts = gl.getInternalformatParameter(gl.RENDERBUFFER, format, gl.SAMPLES) as Int32Array | null
  return counts?.[0] ?? 0
}

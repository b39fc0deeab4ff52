/** Textures and framebuffers. */
import { RendererError } from '../errors'

export interface ColourFormat {
  readonly internal: number
  readonly format: number
  readonly type: number
}

/** Texture storage without mipmaps, clamped. */
export function makeTexture(
  gl: WebGL2RenderingContext,
  format: number,
  width: number,
  height: number,
  filter: number,
): WebGLTexture {
  const texture = gl.createTexture()
  gl.activeTexture(gl.TEXTURE0)
  gl.bindTexture(gl.TEXTURE_2D, texture)
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height)
  setSampling(gl, gl.TEXTURE_2D, filter)
  return texture
}

export function setSampling(gl: WebGL2RenderingContext, target: number, filter: number): void {
  gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, filter)
  gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, filter)
  gl.texParameteri(target, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE)
  gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE)
  if (target === gl.TEXTURE_3D) {
    gl.texParameteri(target, gl.TEXTURE_WRAP_R, gl.CLAMP_TO_EDGE)
  }
}

/** A framebuffer whose attachments are textures that it owns. */
export class Target {
  readonly framebuffer: WebGLFramebuffer
  readonly colours: readonly WebGLTexture[]
  readonly depth: WebGLTexture | null

  /** @throws RendererError when the device cannot render to these formats. */
  constructor(
    readonly gl: WebGL2RenderingContext,
    readonly name: string,
    readonly width: number,
    readonly height: number,
    colourFormats: readonly number[],
    depthFormat: number | null = null,
  ) {
    this.framebuffer = gl.createFramebuffer()
    this.colours = colourFormats.map((format) => makeTexture(gl, format, width, height, gl.NEAREST))
    this.depth = depthFormat === null ? null : makeTexture(gl, depthFormat, width, height, gl.NEAREST)
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer)
    this.colours.forEach((texture, i) => {
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, texture, 0)
    })
    if (this.depth) {
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.depth, 0)
    }
    gl.drawBuffers(this.colours.length > 0 ? this.colours.map((_, i) => gl.COLOR_ATTACHMENT0 + i) : [gl.NONE])
    const status = gl.checkFramebufferStatus(gl.FRAMEBUFFER)
    if (status !== gl.FRAMEBUFFER_COMPLETE && !gl.isContextLost()) {
      this.dispose()
      throw new RendererError(
        `This device cannot draw the picture buffer "${name}" (${width} x ${height}, status 0x${status.toString(16)}). ` +
          'Update the browser, or use another device.',
      )
    }
  }

  bind(): void {
    const gl = this.gl
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer)
    gl.viewport(0, 0, this.width, this.height)
  }

  colour(index = 0): { target: number; texture: WebGLTexture | null } {
    return { target: this.gl.TEXTURE_2D, texture: this.colours[index] ?? null }
  }

  depthTexture(): { target: number; texture: WebGLTexture | null } {
    return { target: this.gl.TEXTURE_2D, texture: this.depth }
  }

  dispose(): void {
    this.gl.deleteFramebuffer(this.framebuffer)
    for (const texture of [...this.colours, this.depth]) {
      this.gl.deleteTexture(texture)
    }
  }
}

/** A float data texture, one row per record. */
export class DataTexture {
  readonly #gl: WebGL2RenderingContext
  readonly #texture: WebGLTexture
  constructor(
    gl: WebGL2RenderingContext,
    readonly columns: number,
    readonly rows: number,
  ) {
    this.#gl = gl
    this.#texture = makeTexture(gl, gl.RGBA32F, columns, rows, gl.NEAREST)
  }

  upload(data: Float32Array): void {
    const gl = this.#gl
    gl.activeTexture(gl.TEXTURE0)
    gl.bindTexture(gl.TEXTURE_2D, this.#texture)
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, this.columns, this.rows, gl.RGBA, gl.FLOAT, data)
  }

  binding(): { target: number; texture: WebGLTexture } {
    return { target: this.#gl.TEXTURE_2D, texture: this.#texture }
  }

  dispose(): void {
    this.#gl.deleteTexture(this.#texture)
  }
}

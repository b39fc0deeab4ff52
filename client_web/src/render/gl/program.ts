/** A linked GLSL program with its uniforms by name. */
import { RendererError } from '../errors'

export interface TextureBinding {
  readonly target: number
  readonly texture: WebGLTexture | null
  readonly sampler?: WebGLSampler
}

export class Program {
  readonly #gl: WebGL2RenderingContext
  readonly #program: WebGLProgram
  readonly #locations = new Map<string, WebGLUniformLocation | null>()

  /** @throws RendererError when the device's compiler refuses the shader. */
  constructor(gl: WebGL2RenderingContext, name: string, source: { vertex: string; fragment: string }) {
    this.#gl = gl
    this.#program = gl.createProgram()
    const stages = [
      this.#compile(gl.VERTEX_SHADER, `${name} (vertex stage)`, source.vertex),
      this.#compile(gl.FRAGMENT_SHADER, `${name} (fragment stage)`, source.fragment),
    ]
    for (const stage of stages) {
      gl.attachShader(this.#program, stage)
    }
    gl.linkProgram(this.#program)
    if (!gl.getProgramParameter(this.#program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = [gl.getProgramInfoLog(this.#program), ...stages.map((stage) => gl.getShaderInfoLog(stage))]
      throw new RendererError(
        `The graphics driver of this device refused the shader "${name}": ${logs.filter(Boolean).join(' ')}`,
      )
    }
    for (const stage of stages) {
      gl.deleteShader(stage)
    }
  }

  #compile(type: number, name: string, source: string): WebGLShader {
    const shader = this.#gl.createShader(type)
    if (!shader) {
      throw new RendererError(`The graphics context was lost while "${name}" was made. Reload the page.`)
    }
    this.#gl.shaderSource(shader, source)
    this.#gl.compileShader(shader)
    return shader
  }

  use(): this {
    this.#gl.useProgram(this.#program)
    return this
  }

  #location(name: string): WebGLUniformLocation | null {
    let location = this.#locations.get(name)
    if (location === undefined) {
      location = this.#gl.getUniformLocation(this.#program, name)
      this.#locations.set(name, location)
    }
    return location
  }

  int(name: string, value: number | boolean): this {
    this.#gl.uniform1i(this.#location(name), Number(value))
    return this
  }

  int2(name: string, x: number, y: number): this {
    this.#gl.uniform2i(this.#location(name), x, y)
    return this
  }

  float(name: string, ...values: number[]): this {
    const location = this.#location(name)
    const gl = this.#gl
    if (values.length === 1) gl.uniform1fv(location, values)
    else if (values.length === 2) gl.uniform2fv(location, values)
    else if (values.length === 3) gl.uniform3fv(location, values)
    else gl.uniform4fv(location, values)
    return this
  }

  uint(name: string, value: number): this {
    this.#gl.uniform1ui(this.#location(name), value)
    return this
  }

  vec2Array(name: string, values: Float32Array): this {
    this.#gl.uniform2fv(this.#location(name), values)
    return this
  }

  vec4Array(name: string, values: Float32Array): this {
    this.#gl.uniform4fv(this.#location(name), values)
    return this
  }

  vec3Array(name: string, values: Float32Array): this {
    this.#gl.uniform3fv(this.#location(name), values)
    return this
  }

  mat3(name: string, columns: Float32Array): this {
    this.#gl.uniformMatrix3fv(this.#location(name), false, columns)
    return this
  }

  mat4(name: string, columns: Float32Array): this {
    this.#gl.uniformMatrix4fv(this.#location(name), false, columns)
    return this
  }

  /** Binds textures to units 0, 1, ... in order. */
  textures(bindings: Readonly<Record<string, TextureBinding>>): this {
    const gl = this.#gl
    Object.entries(bindings).forEach(([name, binding], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit)
      gl.bindTexture(binding.target, binding.texture)
      gl.bindSampler(unit, binding.sampler ?? null)
      gl.uniform1i(this.#location(name), unit)
    })
    return this
  }

  dispose(): void {
    this.#gl.deleteProgram(this.#program)
  }
}

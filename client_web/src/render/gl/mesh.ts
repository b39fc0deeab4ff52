/** Vertex data on the GPU. */
export interface Attribute {
  readonly location: number
  readonly size: number
  readonly data: Float32Array
}

export class GpuMesh {
  readonly #gl: WebGL2RenderingContext
  readonly #vertexArray: WebGLVertexArrayObject
  readonly #buffers: WebGLBuffer[] = []
  readonly #count: number

  constructor(gl: WebGL2RenderingContext, attributes: readonly Attribute[], indices: Uint32Array) {
    this.#gl = gl
    this.#count = indices.length
    this.#vertexArray = gl.createVertexArray()
    gl.bindVertexArray(this.#vertexArray)
    for (const { location, size, data } of attributes) {
      this.#fill(gl.ARRAY_BUFFER, data)
      gl.enableVertexAttribArray(location)
      gl.vertexAttribPointer(location, size, gl.FLOAT, false, 0, 0)
    }
    this.#fill(gl.ELEMENT_ARRAY_BUFFER, indices)
    gl.bindVertexArray(null)
  }

  #fill(target: number, data: Float32Array | Uint32Array): void {
    const buffer = this.#gl.createBuffer()
    this.#gl.bindBuffer(target, buffer)
    this.#gl.bufferData(target, data, this.#gl.STATIC_DRAW)
    this.#buffers.push(buffer)
  }

  draw(): void {
    this.#gl.bindVertexArray(this.#vertexArray)
    this.#gl.drawElements(this.#gl.TRIANGLES, this.#count, this.#gl.UNSIGNED_INT, 0)
  }

  dispose(): void {
    this.#gl.deleteVertexArray(this.#vertexArray)
    for (const buffer of this.#buffers) {
      this.#gl.deleteBuffer(buffer)
    }
  }
}

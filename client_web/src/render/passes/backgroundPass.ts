import { drawScreen } from '../device'
import { RendererError } from '../errors'
import { Program } from '../gl/program'
import { setSampling, type Target } from '../gl/targets'
import { SHADERS } from '../glsl'
import type { HalfPicture, LightAsset, ViewAsset } from '../types'

const MAX_PICTURES = 64

/** Linear radiance of the tablet's camera picture: a mix of basis pictures, one per lamp. Inputs: view, light weights, size. */
export class BackgroundPass {
  readonly #gl: WebGL2RenderingContext
  readonly #sameSize: Program
  readonly #resized: Program
  readonly #views: readonly ViewAsset[]
  readonly #lights: readonly LightAsset[]
  readonly #pictures = new Map<number, WebGLTexture>()

  constructor(gl: WebGL2RenderingContext, views: readonly ViewAsset[], lights: readonly LightAsset[]) {
    this.#gl = gl
    this.#sameSize = new Program(gl, 'background', SHADERS.backgroundSameSize)
    this.#resized = new Program(gl, 'resized background', SHADERS.background)
    this.#views = views
    this.#lights = lights
  }

  run(target: Target, viewIndex: number, weights: ArrayLike<number>): void {
    const view = this.#views[viewIndex]
    if (!view) return
    const gl = this.#gl
    const factors = new Float32Array(3 * MAX_PICTURES)
    view.pictures.forEach((_, k) => {
      // image = sum of weight * radiance / basis_radiance * picture; a lone picture without lights stands for itself.
      const light = this.#lights[k]
      const factor = light ? (weights[k] ?? light.weight) / light.basisRadiance : 1
      factors.set(light ? light.radiance.map((v) => v * factor) : [1, 1, 1], 3 * k)
    })
    target.bind()
    const isSameSize = view.width === target.width && view.height === target.height
    ;(isSameSize ? this.#sameSize : this.#resized)
      .use()
      .textures({
        uPictures: { target: gl.TEXTURE_2D_ARRAY, texture: this.#texture(viewIndex, view.pictures) },
      })
      .int('uNumPictures', view.pictures.length)
      .vec3Array('uWeights', factors)
      .float('uTargetSize', target.width, target.height)
    drawScreen(gl)
  }

  #texture(viewIndex: number, pictures: readonly HalfPicture[]): WebGLTexture {
    const known = this.#pictures.get(viewIndex)
    if (known) return known
    const gl = this.#gl
    const first = pictures[0]
    if (!first || pictures.length > MAX_PICTURES) {
      throw new RendererError(
        `View ${viewIndex} has ${pictures.length} background pictures; expected 1 to ${MAX_PICTURES}.`,
      )
    }
    const texture = gl.createTexture()
    gl.activeTexture(gl.TEXTURE0)
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture)
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA16F, first.width, first.height, pictures.length)
    setSampling(gl, gl.TEXTURE_2D_ARRAY, gl.LINEAR)
    pictures.forEach((picture, layer) => {
      gl.texSubImage3D(
        gl.TEXTURE_2D_ARRAY,
        0,
        0,
        0,
        layer,
        picture.width,
        picture.height,
        1,
        gl.RGBA,
        gl.HALF_FLOAT,
        picture.data,
      )
    })
    // Pictures of the other views are uploaded again when they are looked at: one view at a time is on the GPU.
    for (const [index, old] of this.#pictures) {
      gl.deleteTexture(old)
      this.#pictures.delete(index)
    }
    this.#pictures.set(viewIndex, texture)
    return texture
  }

  dispose(): void {
    this.#sameSize.dispose()
    this.#resized.dispose()
    for (const texture of this.#pictures.values()) {
      this.#gl.deleteTexture(texture)
    }
    this.#pictures.clear()
  }
}

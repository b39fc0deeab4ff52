import { Program } from '../gl/program'
import { Target } from '../gl/targets'
import { SHADERS } from '../glsl'
import type { SceneMeshes } from '../sceneMeshes'
import { multiply4 } from '../vector'
import type { Frame } from './frame'

/** Room and virtual objects in one G-buffer: albedo + kind, normal, indirect radiance of the objects, depth. */
export class GbufferPass {
  readonly #gl: WebGL2RenderingContext
  readonly #room: Program
  readonly #object: Program

  constructor(gl: WebGL2RenderingContext) {
    this.#gl = gl
    this.#room = new Program(gl, 'G-buffer of the room', SHADERS.gbufferRoom)
    this.#object = new Program(gl, 'G-buffer of objects', SHADERS.gbufferObject)
  }

  makeTarget(width: number, height: number): Target {
    const gl = this.#gl
    return new Target(
      gl,
      'G-buffer',
      width,
      height,
      [gl.RGBA16F, gl.RG16UI, gl.RGBA16F],
      gl.DEPTH_COMPONENT32F,
    )
  }

  run(target: Target, frame: Frame, meshes: SceneMeshes): void {
    const gl = this.#gl
    target.bind()
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0])
    gl.clearBufferuiv(gl.COLOR, 1, [0, 0, 0, 0])
    gl.clearBufferfv(gl.COLOR, 2, [0, 0, 0, 0])
    gl.clearBufferfv(gl.DEPTH, 0, [1])
    gl.enable(gl.DEPTH_TEST)
    // Surfaces are one-sided: a free camera outside the room looks in.
    gl.enable(gl.CULL_FACE)
    this.#room.use().mat4('uClipFromWorld', frame.camera.clipFromWorld)
    meshes.room.draw()
    gl.disable(gl.CULL_FACE)
    this.#object.use()
    meshes.objects.forEach((mesh, index) => {
      const object = frame.objects[index]
      if (!object) return
      const m = object.worldFromObject
      const rotation = new Float32Array([0, 1, 2, 4, 5, 6, 8, 9, 10].map((i) => m[i] ?? 0))
      this.#object
        .mat4('uClipFromObject', multiply4(frame.camera.clipFromWorld, m))
        .mat3('uWorldFromObject', rotation)
        .float('uAlbedoOfObject', ...mesh.asset.albedo)
        .float('uBounceRatio', mesh.asset.bounceRatio)
        .float('uKind', index + 1)
        .float('uGroundReflectance', ...object.groundReflectance)
        .vec3Array('uShIndirect', object.shIndirect)
        .vec3Array('uShAll', object.shAll)
      mesh.full.draw()
    })
    gl.disable(gl.DEPTH_TEST)
  }

  dispose(): void {
    this.#room.dispose()
    this.#object.dispose()
  }
}

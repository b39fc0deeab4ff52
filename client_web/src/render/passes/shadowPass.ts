import { MAX_VALS } from '../../radiometry/valLight'
import { FIXTURE_SHARE } from '../fixtureVisibility'
import { Program, type TextureBinding } from '../gl/program'
import { Target } from '../gl/targets'
import { SHADERS } from '../glsl'
import type { SceneMeshes } from '../sceneMeshes'
import { SHADOW_NEAR, type ShadowFit } from '../shadowFit'
import type { ShadowWork } from '../shadowSchedule'
import type { Vec3 } from '../vector'
import type { Frame } from './frame'

/** Tiles per side of an atlas: one tile per VAL. */
export const TILES_PER_SIDE = Math.sqrt(MAX_VALS)
const IDENTITY = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])

/**
 * Depth maps of the room and of the virtual objects, one tile per VAL and layer (Rohmer et al. 2014, section 5).
 *
 * The room casts with the faces that the VAL sees, so a VAL just behind a surface is not hidden by it. Virtual objects cast with the
 * faces turned away, so neither their lit side nor what they stand on is shaded by rounding.
 */
export class ShadowPass {
  readonly #gl: WebGL2RenderingContext
  readonly #program: Program
  readonly #compare: WebGLSampler
  readonly #room: Target
  readonly #virtual: Target

  constructor(
    gl: WebGL2RenderingContext,
    readonly tileSize: number,
  ) {
    this.#gl = gl
    this.#program = new Program(gl, 'shadow maps', SHADERS.shadowMap)
    const size = TILES_PER_SIDE * tileSize
    const depth = gl.DEPTH_COMPONENT32F
    this.#room = new Target(gl, 'shadow maps of the room', size, size, [], depth)
    this.#virtual = new Target(gl, 'shadow maps of the objects', size, size, [], depth)
    this.#compare = gl.createSampler()
    gl.samplerParameteri(this.#compare, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE)
    gl.samplerParameteri(this.#compare, gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL)
    for (const parameter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.samplerParameteri(this.#compare, parameter, gl.LINEAR)
    }
    for (const parameter of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
      gl.samplerParameteri(this.#compare, parameter, gl.CLAMP_TO_EDGE)
    }
  }

  run(
    work: readonly ShadowWork[],
    positions: (slot: number) => Vec3,
    fits: readonly (ShadowFit | null)[],
    frame: Frame,
    meshes: SceneMeshes,
  ): void {
    const gl = this.#gl
    gl.enable(gl.DEPTH_TEST)
    gl.enable(gl.SCISSOR_TEST)
    gl.enable(gl.CULL_FACE)
    this.#program.use().float('uShadowNear', SHADOW_NEAR)
    for (const isRoom of [true, false]) {
      ;(isRoom ? this.#room : this.#virtual).bind()
      gl.cullFace(isRoom ? gl.BACK : gl.FRONT)
      for (const { slot, room, virtual } of work) {
        const fit = fits[slot]
        if (!fit || !(isRoom ? room : virtual)) continue
        this.#aim(slot, positions(slot), fit)
        if (isRoom) {
          // Nearer blockers are the fixture's: fixtureVisibility.ts.
          const nearest = Math.max(FIXTURE_SHARE * fit.nearestCaster, SHADOW_NEAR)
          this.#program.float('uNearestDepth', 1 - SHADOW_NEAR / nearest).mat4('uWorldFromObject', IDENTITY)
          meshes.room.draw()
        } else {
          this.#program.float('uNearestDepth', 0)
          this.#drawObjects(frame, meshes)
        }
      }
    }
    gl.cullFace(gl.BACK)
    gl.disable(gl.CULL_FACE)
    gl.disable(gl.DEPTH_TEST)
    gl.disable(gl.SCISSOR_TEST)
  }

  #aim(slot: number, position: Vec3, fit: ShadowFit): void {
    const gl = this.#gl
    const x = (slot % TILES_PER_SIDE) * this.tileSize
    const y = Math.floor(slot / TILES_PER_SIDE) * this.tileSize
    gl.viewport(x, y, this.tileSize, this.tileSize)
    gl.scissor(x, y, this.tileSize, this.tileSize)
    gl.clearBufferfv(gl.DEPTH, 0, [1])
    const rows = [fit.right, fit.up, fit.axis]
    this.#program
      .float('uValPosition', ...position)
      .mat3('uMapFromWorld', new Float32Array([0, 1, 2].flatMap((c) => rows.map((row) => row[c] ?? 0))))
      .float('uWindow', ...fit.scale, ...fit.offset)
  }

  #drawObjects(frame: Frame, meshes: SceneMeshes): void {
    meshes.objects.forEach((mesh, index) => {
      const object = frame.objects[index]
      if (object) {
        this.#program.mat4('uWorldFromObject', new Float32Array(object.worldFromObject))
        ;(frame.options.fullQuality ? mesh.full : mesh.proxy).draw()
      }
    })
  }

  /** Samplers of chunks/shadow.glsl. */
  bindings(): Record<string, TextureBinding> {
    const target = this.#gl.TEXTURE_2D
    return {
      uVirtualDepth: { target, texture: this.#virtual.depth },
      uVirtualCompare: { target, texture: this.#virtual.depth, sampler: this.#compare },
      uRoomDepth: { target, texture: this.#room.depth },
      uRoomCompare: { target, texture: this.#room.depth, sampler: this.#compare },
    }
  }

  dispose(): void {
    this.#program.dispose()
    this.#room.dispose()
    this.#virtual.dispose()
    this.#gl.deleteSampler(this.#compare)
  }
}

import { NEAR } from '../camera'
import { drawScreen } from '../device'
import { Program } from '../gl/program'
import type { Target } from '../gl/targets'
import { SHADERS } from '../glsl'
import type { Frame } from './frame'

/** Vertices of one marker: 24 triangles of the disc, one for the normal. */
const MARKER_VERTICES = 75

/** Width of the outline around the selected object, as a share of the picture's height: 1 / this. */
const OUTLINE_SHARE = 500

/**
 * Background and change to the canvas, by exposure and transfer function; the selected object's outline and markers of the VALs on
 * top. Inputs: background, change, exposure. All that a frame costs in which only the camera picture is new.
 */
export class DisplayPass {
  readonly #gl: WebGL2RenderingContext
  readonly #plain: Program
  readonly #outlined: Program
  readonly #marker: Program

  constructor(gl: WebGL2RenderingContext) {
    this.#gl = gl
    this.#plain = new Program(gl, 'display', SHADERS.display)
    this.#outlined = new Program(gl, 'display with outline', SHADERS.displayOutlined)
    this.#marker = new Program(gl, 'light markers', SHADERS.valMarker)
  }

  /** @param backgroundShare 0 leaves the background out. */
  run(frame: Frame, background: Target, change: Target, gbuffer: Target, backgroundShare: number): void {
    const gl = this.#gl
    gl.bindFramebuffer(gl.FRAMEBUFFER, null)
    gl.viewport(0, 0, change.width, change.height)
    const isOutlined = frame.options.selectedObject >= 0
    ;(isOutlined ? this.#outlined : this.#plain)
      .use()
      .textures({
        uBackground: background.colour(),
        uChange: change.colour(),
        ...(isOutlined ? { uAlbedo: gbuffer.colour(0) } : {}),
      })
      .float('uBackgroundShare', backgroundShare)
      .float('uExposure', frame.options.exposure)
      .int('uSoftClip', frame.options.softClip)
      .int('uSelectedKind', frame.options.selectedObject + 1)
      .float('uOutlineWidth', Math.max(0.75, change.height / OUTLINE_SHARE))
    drawScreen(gl)
    if (!frame.options.showVals || frame.valCount === 0) return
    gl.enable(gl.BLEND)
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA)
    this.#marker
      .use()
      .textures({ uValData: frame.valData.binding(), uDepth: gbuffer.depthTexture() })
      .mat4('uClipFromWorld', frame.camera.clipFromWorld)
      .float('uNear', NEAR)
    gl.bindVertexArray(null)
    gl.drawArraysInstanced(gl.TRIANGLES, 0, MARKER_VERTICES, frame.valCount)
    gl.disable(gl.BLEND)
  }

  dispose(): void {
    this.#plain.dispose()
    this.#outlined.dispose()
    this.#marker.dispose()
  }
}

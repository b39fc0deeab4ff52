/** The WebGL2 context and what it can do. */
import { RendererError } from './errors'
import { Target } from './gl/targets'

export interface Device {
  readonly gl: WebGL2RenderingContext
  /** Format of linear radiance: RGBA32F where it can be drawn to, else RGBA16F. */
  readonly radianceFormat: number
}

/** @throws RendererError when the browser or the device has no WebGL2 with float targets. */
export function openDevice(canvas: HTMLCanvasElement): Device {
  const gl = canvas.getContext('webgl2', {
    alpha: false,
    antialias: false,
    depth: false,
    stencil: false,
    powerPreference: 'high-performance',
    preserveDrawingBuffer: false,
  })
  if (!gl) {
    throw new RendererError(
      'This browser offers no WebGL2. Switch on hardware acceleration, or use a current Safari, Chrome or Firefox.',
    )
  }
  return probeDevice(gl)
}

export function probeDevice(gl: WebGL2RenderingContext): Device {
  const hasFloat = gl.getExtension('EXT_color_buffer_float') !== null
  const hasHalf = gl.getExtension('EXT_color_buffer_half_float') !== null
  if (!hasFloat && !hasHalf && !gl.isContextLost()) {
    throw new RendererError(
      'This device cannot draw pictures with high dynamic range (EXT_color_buffer_float is missing). Use a newer tablet or browser.',
    )
  }
  const units = gl.getParameter(gl.MAX_TEXTURE_IMAGE_UNITS) as number
  if (units < 16) {
    throw new RendererError(`This device reads only ${units} textures at once; the renderer needs 16.`)
  }
  return { gl, radianceFormat: hasFloat && canDraw(gl, gl.RGBA32F) ? gl.RGBA32F : gl.RGBA16F }
}

/** Some devices list float targets and then refuse them, so one is made. */
function canDraw(gl: WebGL2RenderingContext, format: number): boolean {
  try {
    new Target(gl, 'probe', 4, 4, [format]).dispose()
    return true
  } catch (error) {
    if (error instanceof RendererError) {
      return false
    }
    throw error
  }
}

/** Quiet state that every pass starts from. */
export function resetState(gl: WebGL2RenderingContext): void {
  gl.disable(gl.BLEND)
  gl.disable(gl.DEPTH_TEST)
  gl.disable(gl.CULL_FACE)
  gl.disable(gl.SCISSOR_TEST)
  gl.depthMask(true)
  gl.depthFunc(gl.LESS)
  gl.colorMask(true, true, true, true)
  gl.cullFace(gl.BACK)
  gl.frontFace(gl.CCW)
  gl.bindVertexArray(null)
}

/** Draws the screen triangle with the bound program and target. */
export function drawScreen(gl: WebGL2RenderingContext): void {
  gl.bindVertexArray(null)
  gl.drawArrays(gl.TRIANGLES, 0, 3)
}

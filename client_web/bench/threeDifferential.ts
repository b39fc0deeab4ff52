/**
 * Classic differential rendering in three.js (Debevec 1998): the local scene without and with the virtual objects, then
 * background + (with - without) beside the objects and `with` on them. Each of the two pictures has its own shadow maps.
 */
import {
  DepthTexture,
  GLSL3,
  HalfFloatType,
  Mesh,
  NearestFilter,
  OrthographicCamera,
  PlaneGeometry,
  RawShaderMaterial,
  Scene,
  WebGLRenderTarget,
} from 'three'
import { mixBackground } from './background'
import type { BenchLight, BenchScene } from './scene'
import { ThreeScene } from './threeScene'
import type { DrawingOptions, Variant } from './variant'

const VERTEX = `
in vec3 position;
void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }
`
const FRAGMENT = `
precision highp float;
uniform sampler2D uWith, uWithout, uDepthWith, uDepthWithout, uBackground;
uniform float uExposure;
out vec4 colour;
void main() {
  ivec2 p = ivec2(gl_FragCoord.xy);
  vec3 augmented = texelFetch(uWith, p, 0).rgb;
  vec3 background = texture(uBackground, gl_FragCoord.xy / vec2(textureSize(uWith, 0))).rgb;
  bool isVirtual = texelFetch(uDepthWith, p, 0).r < texelFetch(uDepthWithout, p, 0).r;
  vec3 radiance = isVirtual ? augmented : background + augmented - texelFetch(uWithout, p, 0).rgb;
  vec3 c = clamp(uExposure * radiance, 0.0, 1.0);
  colour = vec4(mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)), 1.0);
}
`

export class ThreeDifferential implements Variant {
  readonly #three: ThreeScene
  readonly #without: WebGLRenderTarget
  readonly #with: WebGLRenderTarget
  readonly #screen = new Scene()
  readonly #screenCamera = new OrthographicCamera()

  constructor(scene: BenchScene, light: BenchLight, exposure: number, drawing: DrawingOptions) {
    // Lambert: all surfaces of the scene are Lambertian, and it is the cheapest of three's materials that says so.
    this.#three = new ThreeScene(scene, light, 'lambert', drawing)
    const { width, height } = scene.lens
    const target = (): WebGLRenderTarget => {
      const depthTexture = new DepthTexture(width, height)
      return new WebGLRenderTarget(width, height, {
        type: HalfFloatType,
        minFilter: NearestFilter,
        magFilter: NearestFilter,
        depthTexture,
      })
    }
    this.#without = target()
    this.#with = target()
    const material = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      depthTest: false,
      depthWrite: false,
      uniforms: {
        uWith: { value: this.#with.texture },
        uWithout: { value: this.#without.texture },
        uDepthWith: { value: this.#with.depthTexture },
        uDepthWithout: { value: this.#without.depthTexture },
        uBackground: { value: mixBackground(scene) },
        uExposure: { value: exposure },
      },
    })
    const quad = new Mesh(new PlaneGeometry(2, 2), material)
    quad.frustumCulled = false
    this.#screen.add(quad)
  }

  get canvas(): HTMLCanvasElement {
    return this.#three.canvas
  }

  get gl(): WebGL2RenderingContext {
    return this.#three.gl
  }

  draw(frame: number): void {
    this.#three.move(frame)
    for (const target of [this.#without, this.#with]) {
      for (const object of this.#three.objects) object.visible = target === this.#with
      this.#render(target)
    }
    const { renderer } = this.#three
    renderer.setRenderTarget(null)
    renderer.render(this.#screen, this.#screenCamera)
  }

  #render(target: WebGLRenderTarget): void {
    const { renderer, scene, camera } = this.#three
    renderer.setRenderTarget(target)
    renderer.render(scene, camera)
  }

  dispose(): void {
    this.#with.dispose()
    this.#without.dispose()
    this.#three.dispose()
  }
}

/** three.js drawing the whole scene once, straight to the canvas. */
import { LinearToneMapping, SRGBColorSpace } from 'three'
import type { BenchLight, BenchScene } from './scene'
import { ThreeScene } from './threeScene'
import type { DrawingOptions, Variant } from './variant'

export class ThreeForward implements Variant {
  readonly #three: ThreeScene

  constructor(scene: BenchScene, light: BenchLight, exposure: number, drawing: DrawingOptions) {
    this.#three = new ThreeScene(scene, light, 'standard', drawing)
    const { renderer } = this.#three
    renderer.outputColorSpace = SRGBColorSpace
    renderer.toneMapping = LinearToneMapping
    renderer.toneMappingExposure = exposure
  }

  get canvas(): HTMLCanvasElement {
    return this.#three.canvas
  }

  get gl(): WebGL2RenderingContext {
    return this.#three.gl
  }

  draw(frame: number): void {
    this.#three.move(frame)
    this.#three.renderer.render(this.#three.scene, this.#three.camera)
  }

  dispose(): void {
    this.#three.dispose()
  }
}

/** `window.bench`: draws the same scene with several renderers, frame by frame as the benchmark asks. */
import { type Growth, grow, trianglesOf } from './growth'
import { Ours } from './ours'
import { PlayCanvas } from './playcanvas'
import { type BenchLight, type BenchScene, loadBenchScene, readLight } from './scene'
import { ThreeDifferential } from './threeDifferential'
import { ThreeForward } from './threeForward'
import { type DrawingOptions, type FrameKind, finishFrame, type Variant } from './variant'

interface Setting {
  readonly scene: BenchScene
  readonly light: BenchLight
  readonly exposure: number
  readonly drawing: DrawingOptions
}

const MAKERS: Readonly<Record<string, (setting: Setting) => Variant | Promise<Variant>>> = {
  ours: ({ scene, light, exposure, drawing }) => Ours.create(scene, light, exposure, drawing),
  three: ({ scene, light, exposure, drawing }) => new ThreeForward(scene, light, exposure, drawing),
  differential: ({ scene, light, exposure, drawing }) =>
    new ThreeDifferential(scene, light, exposure, drawing),
  playcanvas: ({ scene, light, exposure, drawing }) => PlayCanvas.create(scene, light, exposure, drawing),
}

let scene: BenchScene | null = null
/** With the number of the next frame. */
const variants = new Map<string, { readonly variant: Variant; frame: number }>()

function find(name: string): { readonly variant: Variant; frame: number } {
  const entry = variants.get(name)
  if (!entry) throw new Error(`There is no variant ${name}; create it first.`)
  return entry
}

const MOVING_ALL: readonly FrameKind[] = ['full', 'same maps']

/** A started variant must not leave shadow maps of former frames to a frame that is timed. */
function settle(variant: Variant): void {
  if (variant instanceof Ours) variant.settle()
}

const bench = {
  /** Loads the scene and fixes the size of all pictures, pixels. */
  async load(width: number, height: number): Promise<void> {
    scene = await loadBenchScene(width, height)
  },

  /**
   * Makes a variant; its first frame, for which shaders are compiled, is drawn by `prepare` or `picture`.
   *
   * @param packet base64 of a light packet.
   * @param growth changes to the scene.
   * @returns numbers of VALs and of triangles of virtual objects that it draws.
   */
  async create(
    name: string,
    maker: string,
    packet: string,
    exposure: number,
    drawing: DrawingOptions,
    growth: Growth,
  ): Promise<{ vals: number; triangles: number }> {
    const make = MAKERS[maker]
    if (!scene || !make) throw new Error(scene ? `No renderer ${maker}.` : 'Load the scene first.')
    const grown = grow(scene, readLight(packet), growth)
    const variant = await make({ ...grown, exposure, drawing })
    variants.set(name, { variant, frame: 0 })
    return { vals: grown.light.count, triangles: trianglesOf(grown.scene) }
  },

  /** Brings a variant to where frames of this kind start from; what follows is timed. */
  prepare(name: string, kind: FrameKind): void {
    const entry = find(name)
    if (entry.frame === 0) entry.variant.draw(entry.frame++, 'full')
    // Where everything moves, nothing that a former frame left over matters.
    if (!MOVING_ALL.includes(kind)) settle(entry.variant)
    finishFrame(entry.variant.gl)
  },

  /** Draws frames and waits for each. Times in ms: of the whole, and of the page's own part without waiting. */
  run(name: string, kind: FrameKind, frames: number): { wallMs: number; submitMs: number } {
    const entry = find(name)
    const started = performance.now()
    let submitMs = 0
    for (let i = 0; i < frames; i++) {
      const before = performance.now()
      entry.variant.draw(entry.frame++, kind)
      submitMs += performance.now() - before
      finishFrame(entry.variant.gl)
    }
    return { wallMs: performance.now() - started, submitMs }
  },

  /** Passes of the last frame of ours: name and whether it ran. */
  passes(name: string): { name: string; ran: boolean }[] {
    const { variant } = find(name)
    return variant instanceof Ours ? variant.stats.passes.map(({ name, ran }) => ({ name, ran })) : []
  },

  /** PNG of one frame, as a data URL. */
  picture(name: string): string {
    const entry = find(name)
    entry.variant.draw(entry.frame++, 'full')
    settle(entry.variant)
    const copy = document.createElement('canvas')
    copy.width = entry.variant.canvas.width
    copy.height = entry.variant.canvas.height
    copy.getContext('2d')?.drawImage(entry.variant.canvas, 0, 0)
    return copy.toDataURL('image/png')
  },

  remove(name: string): void {
    find(name).variant.dispose()
    variants.delete(name)
  },
}

declare global {
  interface Window {
    bench: typeof bench
  }
}

window.bench = bench

/** `window.nearfield`: what tests and `nearfield evaluate` drive the page with. */
import { poseFromRowMajor, rowMajorOf } from '../interaction/pose'
import type { ViewChoice } from '../ui/shell'
import { type CompositeQuality, drawFrame, takeComposite } from './composite'
import type { MethodSettings, Platform } from './ports'
import type { Viewer } from './viewer'

export interface NearfieldApi {
  /** Resolves once pictures can be drawn; rejects with the words that the page shows. */
  readonly ready: Promise<void>
  state(): NearfieldState
  /** Draws a tablet view, in full quality if nothing is said: base64 of little-endian float32 RGBA, linear radiance, row 0 on top. */
  renderViewComposite(
    viewIndex: number,
    quality?: CompositeQuality,
  ): Promise<{ width: number; height: number; data: string }>
  /** Draws one frame of a tablet view in live quality, of what is due in one frame; resolves when it is drawn. */
  drawViewFrame(viewIndex: number): Promise<void>
  changeMethod(settings: Partial<MethodSettings>): void
  setLightWeight(lightIndex: number, weight: number): void
  setView(view: ViewChoice): void
  /** @param worldFromObject row-major 4x4. */
  setObjectPose(objectIndex: number, worldFromObject: readonly number[]): void
  /** Takes a light packet (base64 of its bytes) as if it came from the server; false if it is out of date. */
  applyLightPacket(base64: string): boolean
  /** Resolves once the light of this sequence, or a newer one, is shown without cross-fade. */
  waitForLight(sequence: number): Promise<void>
}

export interface NearfieldState {
  readonly connection: string
  readonly sequence: number | null
  /** Decimal string: capture time on the server's clock, nanoseconds. */
  readonly timestampNs: string | null
  readonly ageMs: number | null
  readonly numVals: number
  readonly packetBytes: number
  readonly weights: readonly number[]
  readonly view: ViewChoice
  /** Row-major 4x4, OpenCV axes. */
  readonly worldFromCamera: readonly number[]
  readonly exposure: number
  readonly selectedObject: number
  /** Row-major 4x4 per object. */
  readonly objectPoses: readonly (readonly number[])[]
  readonly width: number
  readonly height: number
  readonly lastFrame: {
    readonly passes: readonly { readonly name: string; readonly ran: boolean; readonly reason: string }[]
    readonly cpuMs: number
  }
}

declare global {
  interface Window {
    nearfield: NearfieldApi
  }
}

export function createTestApi(starting: Promise<Viewer>, platform: Platform): NearfieldApi {
  let viewer: Viewer | null = null
  const ready = starting.then((started) => {
    viewer = started
  })
  // The page shows the reason itself; whoever awaits `ready` still gets it.
  ready.catch(() => undefined)
  const running = (): Viewer => {
    if (!viewer) {
      throw new Error('The page is not ready: await window.nearfield.ready first.')
    }
    return viewer
  }
  return {
    ready,
    state: () => stateOf(running()),
    renderViewComposite: async (viewIndex, quality) => {
      const { width, height, rgba } = await takeComposite(running(), viewIndex, quality)
      return { width, height, data: await toBase64(rgba) }
    },
    drawViewFrame: (viewIndex) => drawFrame(running(), viewIndex),
    changeMethod: (settings) => running().changeMethod(settings),
    setLightWeight: (lightIndex, weight) => running().setLightWeight(lightIndex, weight),
    setView: (view) => running().selectView(view),
    setObjectPose: (objectIndex, worldFromObject) =>
      running().objects.setPose(objectIndex, poseFromRowMajor(worldFromObject)),
    applyLightPacket: (base64) => {
      const bytes = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0))
      return running().takeLight(platform.decodeLightPacket(bytes.buffer), bytes.byteLength)
    },
    waitForLight: (sequence) => {
      const { feed } = running()
      const shown = feed.waitFor(sequence)
      feed.settle()
      return shown
    },
  }
}

function stateOf(viewer: Viewer): NearfieldState {
  const { feed } = viewer
  return {
    connection: viewer.connectionState.kind,
    sequence: feed.sequence ?? null,
    timestampNs: feed.timestampNs?.toString() ?? null,
    ageMs: feed.ageMs(performance.now()),
    numVals: feed.numVals,
    packetBytes: feed.packetBytes,
    weights: viewer.weights,
    view: viewer.camera.view,
    worldFromCamera: rowMajorOf(viewer.camera.worldFromCamera()),
    exposure: viewer.picture.exposure,
    selectedObject: viewer.objects.selected,
    objectPoses: viewer.scene.objects.map((each) => rowMajorOf(viewer.objects.pose(each.index))),
    width: viewer.numbers.width,
    height: viewer.numbers.height,
    lastFrame: { passes: viewer.report.passes, cpuMs: viewer.report.cpuMs },
  }
}

function toBase64(values: Float32Array): Promise<string> {
  return new Promise((resolve, reject) => {
    const reader = new FileReader()
    reader.onload = () => {
      const url = reader.result as string
      resolve(url.slice(url.indexOf(',') + 1))
    }
    reader.onerror = () => reject(reader.error)
    reader.readAsDataURL(new Blob([values as Float32Array<ArrayBuffer>]))
  })
}

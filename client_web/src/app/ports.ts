/** What the app needs from the renderer and the connection; both are handed in, so that tests can bring their own. */
import type { Pose } from '../interaction/pose'
import type { RoomTriangles } from '../interaction/roomSurface'
import type { AtlasTiles, LightPacket } from '../protocol/codec'
import type { ConnectionEvents, ConnectionState } from '../protocol/connection'
import type { LightFrame } from '../state/lightState'
import type { SceneDescription } from '../state/sceneDescription'

export interface RendererSettings {
  exposure: number
  shadows: boolean
  indirectOcclusion: boolean
  showVals: boolean
  /** Marked on the screen; -1 = none. */
  selectedObject: number
  antiAliasing: boolean
  fullQuality: boolean
}

/** What the benchmark changes to draw the methods of the papers. */
export interface MethodSettings {
  shadows: boolean
  indirectOcclusion: boolean
  fixtureRays: boolean
  roomShadows: boolean
  receiverRatio: boolean
}

export type CameraChoice =
  | { kind: 'tablet'; viewIndex: number }
  | { kind: 'free'; worldFromCamera: Pose; verticalFov: number }

export interface FrameReport {
  readonly passes: readonly { readonly name: string; readonly ran: boolean; readonly reason: string }[]
  readonly cpuMs: number
  /** Work is left over: another frame must follow. */
  readonly pending: boolean
}

interface Point {
  readonly x: number
  readonly y: number
  readonly z: number
}

export interface PictureRenderer {
  setLight(frame: LightFrame): void
  setCamera(camera: CameraChoice): void
  setObjectPose(objectIndex: number, worldFromObject: Pose): void
  setLightWeights(weights: Float32Array): void
  updateAtlas(tiles: AtlasTiles): void
  setOptions(partial: Partial<RendererSettings & MethodSettings>): void
  setSize(widthPixels: number, heightPixels: number): void
  render(nowMs: number): FrameReport
  readComposite(): Float32Array
  pick(xNdc: number, yNdc: number): { objectIndex: number; positionWorld: Point } | null
  dispose(): void
}

export type { ConnectionEvents, ConnectionState }

export interface Connection {
  setLightWeight(lightIndex: number, weight: number): void
  setObjectPose(
    objectIndex: number,
    position: readonly [number, number, number],
    quaternion: readonly [number, number, number, number],
  ): void
  wantAtlas(wanted: boolean): void
  dispose(): void
}

/** The parts that a page is made of. */
export interface Platform {
  /** Loads the models and pictures and makes a renderer. `onProgress` is told bytes. */
  createRenderer(
    canvas: HTMLCanvasElement,
    scene: SceneDescription,
    settings: RendererSettings,
    onProgress: (loadedBytes: number, totalBytes: number) => void,
  ): Promise<{ renderer: PictureRenderer; roomTriangles: RoomTriangles }>
  connect(events: ConnectionEvents): Connection
  /** Protocol version that this page speaks. */
  readonly protocolVersion: number
  decodeLightPacket(buffer: ArrayBuffer): LightPacket
}

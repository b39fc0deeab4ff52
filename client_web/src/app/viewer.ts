/** The running page: light, camera and objects in, pictures out. Draws only when something changed. */
import { PointerInput } from '../interaction/pointerInput'
import type { RoomTriangles } from '../interaction/roomSurface'
import type { ControlState, LightPacket } from '../protocol/codec'
import type { SceneDescription } from '../state/sceneDescription'
import type { PictureSettings } from '../ui/picturePanel'
import type { SceneControls, Shell, ShellActions, ViewChoice } from '../ui/shell'
import { CameraControl } from './cameraControl'
import { aimAtView, type CompositeQuality } from './composite'
import { ControlChannel } from './controlChannel'
import { suitableExposure } from './exposure'
import { FrameLoop } from './frameLoop'
import { FrameTime } from './frameTime'
import { handleKey } from './keyboard'
import { LightFeed } from './lightFeed'
import { ObjectControl } from './objectControl'
import type {
  Connection,
  ConnectionEvents,
  ConnectionState,
  FrameReport,
  MethodSettings,
  PictureRenderer,
  RendererSettings,
} from './ports'
import { ResolutionGovernor } from './resolutionGovernor'

/** After so many unfinished frames the exposure is measured all the same. */
const EXPOSURE_PATIENCE = 90

export interface ViewerOptions {
  /** For `nearfield evaluate`: no interface, no cross-fade, no animation, full quality. */
  readonly evaluate: boolean
}

/** What the viewer cannot deal with itself; it has stopped drawing by then. */
export interface ViewerFaults {
  drawingFailed(error: unknown): void
  roomChanged(): void
}

export interface ViewerNumbers {
  readonly frameMs: number | null
  readonly width: number
  readonly height: number
}

export class Viewer implements ShellActions {
  readonly feed: LightFeed
  readonly camera: CameraControl
  readonly objects: ObjectControl
  readonly scene: SceneDescription
  readonly #shell: Shell
  readonly #renderer: PictureRenderer
  readonly #options: ViewerOptions
  readonly #faults: ViewerFaults
  readonly #loop: FrameLoop
  readonly #governor = new ResolutionGovernor(window.devicePixelRatio)
  readonly #outbox = new ControlChannel()
  readonly #weights: Float32Array
  #controls: SceneControls | null = null
  #connectionState: ConnectionState = { kind: 'connecting' }
  #onConnectionState: (state: ConnectionState) => void = () => undefined
  #picture: PictureSettings
  #exposureDue: boolean
  readonly #frameTime = new FrameTime()
  #report: FrameReport = { passes: [], cpuMs: 0, pending: false }
  #unfinishedFrames = 0
  #hasControlState = false
  #size = { width: 0, height: 0 }

  constructor(
    shell: Shell,
    scene: SceneDescription,
    renderer: PictureRenderer,
    room: RoomTriangles,
    settings: RendererSettings,
    options: ViewerOptions,
    faults: ViewerFaults,
  ) {
    this.#shell = shell
    this.scene = scene
    this.#renderer = renderer
    this.#options = options
    this.#faults = faults
    this.feed = new LightFeed(
      scene.settings.stale_after_ms,
      options.evaluate ? { fadeMs: 0, placeTolerance: 0 } : {},
    )
    this.#picture = { ...settings, autoExposure: scene.settings.exposure === null }
    this.#exposureDue = this.#picture.autoExposure && !options.evaluate
    this.#weights = Float32Array.from(scene.lights, (light) => light.weight)
    this.#loop = new FrameLoop((nowMs, sinceLastMs) => this.#drawSafely(nowMs, sinceLastMs))
    this.objects = new ObjectControl(scene, room, {
      poseChanged: (objectIndex, pose) => {
        renderer.setObjectPose(objectIndex, pose)
        this.requestFrame()
      },
      poseToSend: (objectIndex, parts) => this.#outbox.setObjectPose(objectIndex, parts),
      selected: (objectIndex) => {
        renderer.setOptions({ selectedObject: objectIndex })
        this.#controls?.setSelectedObject(objectIndex)
        this.requestFrame()
      },
      isUnsettled: (objectIndex) => this.#outbox.isObjectUnsettled(objectIndex),
      pick: (xNdc, yNdc) => this.#pick(xNdc, yNdc),
      ray: (xNdc, yNdc) => this.camera.ray(xNdc, yNdc, this.#size.width / this.#size.height),
    })
    if (!options.evaluate) {
      // Before the camera's own listeners: what touches an object must not orbit.
      new PointerInput(shell.canvas, this.objects)
      shell.canvas.addEventListener('keydown', (event) => handleKey(event, this))
    }
    this.camera = new CameraControl(scene, options.evaluate ? null : shell.canvas, () => this.requestFrame())
    scene.objects.forEach((_, index) => {
      renderer.setObjectPose(index, this.objects.pose(index))
    })
    renderer.setLightWeights(this.#weights)
  }

  get connectionState(): ConnectionState {
    return this.#connectionState
  }

  get report(): FrameReport {
    return this.#report
  }

  get weights(): readonly number[] {
    return [...this.#weights]
  }

  get picture(): Readonly<PictureSettings> {
    return this.#picture
  }

  get numbers(): ViewerNumbers {
    return { frameMs: this.#frameTime.medianMs, ...this.#size }
  }

  get controls(): SceneControls | null {
    return this.#controls
  }

  /** Adds the interface and begins to draw. */
  show(): void {
    this.#controls = this.#shell.showScene(this.scene, this)
    this.#controls.setPicture(this.#picture)
    this.selectView(this.camera.view)
    this.layoutChanged()
  }

  /** @param onState told every state of the connection, after the viewer has taken notice. */
  connect(
    open: (events: ConnectionEvents) => Connection,
    onState: (state: ConnectionState) => void,
    onRefused: (text: string) => void,
  ): void {
    this.#onConnectionState = onState
    const connection = open({
      state: (state) => this.#takeConnectionState(state),
      light: (packet, numBytes) => this.takeLight(packet, numBytes),
      atlas: (tiles) => {
        if (this.#isOfThisRoom(tiles.roomRevision)) {
          this.#renderer.updateAtlas(tiles)
          this.requestFrame()
        }
      },
      controlState: (state) => this.#takeControlState(state),
      status: (status) => this.feed.observeStatus(status, performance.now()),
      refused: onRefused,
    })
    this.#outbox.connection = connection
    connection.wantAtlas(this.#wantsAtlas())
  }

  /** Takes a packet as if it had just arrived; also the entrance for tests. */
  takeLight(packet: LightPacket, numBytes: number): boolean {
    if (!this.#isOfThisRoom(packet.roomRevision)) {
      return false
    }
    const isNew = this.feed.push(packet, numBytes, performance.now())
    if (isNew && this.#options.evaluate) {
      this.#takeFrameLight(performance.now())
      this.feed.settle()
    } else if (isNew) {
      this.requestFrame()
    }
    return isNew
  }

  requestFrame(): void {
    if (!this.#options.evaluate) {
      this.#loop.request()
    }
  }

  pause(): void {
    this.#loop.pause()
  }

  resume(): void {
    this.#loop.resume()
    this.requestFrame()
  }

  selectView(view: ViewChoice): void {
    this.camera.select(view)
    this.#controls?.setView(view)
    this.#exposureDue = this.#exposureDue || (this.#picture.autoExposure && view !== 'free')
    this.#outbox.connection?.wantAtlas(this.#wantsAtlas())
    this.layoutChanged()
  }

  setLightWeight(lightIndex: number, weight: number): void {
    if (lightIndex < 0 || lightIndex >= this.#weights.length || !(weight >= 0)) {
      throw new RangeError(
        `light weight: expected light 0 to ${this.#weights.length - 1} and a weight >= 0, ` +
          `found light ${lightIndex} and ${weight}`,
      )
    }
    this.#showLightWeight(lightIndex, weight)
    this.#outbox.setLightWeight(lightIndex, weight)
  }

  selectObject(objectIndex: number): void {
    this.objects.select(objectIndex)
  }

  rotateObject(objectIndex: number, angle: number): void {
    this.objects.rotate(objectIndex, angle)
  }

  resetObject(objectIndex: number): void {
    this.objects.reset(objectIndex)
  }

  changePicture(change: Partial<PictureSettings>): void {
    this.#picture = { ...this.#picture, ...change }
    const { autoExposure, ...settings } = this.#picture
    this.#exposureDue = this.#exposureDue ? autoExposure : change.autoExposure === true
    this.#renderer.setOptions(settings)
    this.#controls?.setPicture(this.#picture)
    this.requestFrame()
  }

  /** Fits the picture into its place; call when the place or the pixels of the screen changed. */
  layoutChanged(): void {
    if (this.#options.evaluate) {
      return
    }
    this.#governor.setDevicePixelRatio(window.devicePixelRatio)
    const fitted = this.#shell.fitPicture(this.camera.aspect)
    const width = Math.max(1, Math.round(fitted.width * this.#governor.scale))
    const height = Math.max(1, Math.round(fitted.height * this.#governor.scale))
    if (width !== this.#size.width || height !== this.#size.height) {
      this.#size = { width, height }
      this.#renderer.setSize(width, height)
    }
    this.requestFrame()
  }

  /** Sets the renderer to a tablet view, whatever the screen shows, lets `draw` use it, and goes back. */
  async drawView(
    viewIndex: number,
    quality: CompositeQuality,
    draw: (renderer: PictureRenderer) => Promise<FrameReport>,
  ): Promise<void> {
    this.#loop.pause()
    aimAtView(this.#renderer, this.scene, viewIndex, quality)
    this.#takeFrameLight(performance.now())
    this.#report = await draw(this.#renderer)
    if (!this.#options.evaluate) {
      this.#renderer.setOptions({ fullQuality: false })
      this.#renderer.setSize(this.#size.width, this.#size.height)
      this.#renderer.setCamera(this.camera.choice())
    }
    this.resume()
  }

  /** For the benchmark, which draws the methods of the papers with the same renderer. */
  changeMethod(settings: Partial<MethodSettings>): void {
    this.#renderer.setOptions(settings)
    this.requestFrame()
  }

  #drawSafely(nowMs: number, sinceLastMs: number | null): boolean {
    try {
      return this.#draw(nowMs, sinceLastMs)
    } catch (error) {
      // A frame that failed would fail again, sixty times a second.
      this.pause()
      this.#faults.drawingFailed(error)
      return false
    }
  }

  #draw(nowMs: number, sinceLastMs: number | null): boolean {
    if (sinceLastMs !== null) {
      this.#frameTime.observe(sinceLastMs)
      if (this.#governor.observe(sinceLastMs)) {
        this.layoutChanged()
      }
    }
    const isMoving = this.camera.update()
    const camera = this.camera.takeChange()
    if (camera) {
      this.#renderer.setCamera(camera)
    }
    // The light is sampled with the clock that stamped its arrival, which the frame time may lag behind.
    this.#takeFrameLight(performance.now())
    this.#report = this.#renderer.render(nowMs)
    this.feed.settle()
    this.#unfinishedFrames = this.#report.pending ? this.#unfinishedFrames + 1 : 0
    if (this.#exposureDue && (!this.#report.pending || this.#unfinishedFrames > EXPOSURE_PATIENCE)) {
      this.#measureExposure()
    }
    return isMoving || this.feed.fading || this.#report.pending
  }

  #takeFrameLight(nowMs: number): void {
    const light = this.feed.next(nowMs)
    if (light) {
      this.#renderer.setLight(light)
    }
  }

  #measureExposure(): void {
    const exposure = suitableExposure(this.#renderer.readComposite())
    if (exposure !== null) {
      this.#exposureDue = false
      this.#picture = { ...this.#picture, exposure }
      this.#renderer.setOptions({ exposure })
      this.#controls?.setPicture(this.#picture)
      this.requestFrame()
    }
  }

  /** Light of another room model cannot be shown in this one: the server was started with another room. */
  #isOfThisRoom(roomRevision: number): boolean {
    const { revision } = this.scene.room
    if (roomRevision !== revision) {
      this.pause()
      this.#faults.roomChanged()
    }
    return roomRevision === revision
  }

  #pick(xNdc: number, yNdc: number): ReturnType<ObjectControl['pickObject']> {
    const hit = this.#renderer.pick(xNdc, yNdc)
    if (!hit || hit.objectIndex < 0) {
      return null
    }
    const ray = this.camera.ray(xNdc, yNdc, this.#size.width / this.#size.height)
    const { x, y, z } = hit.positionWorld
    return { objectIndex: hit.objectIndex, positionWorld: ray.origin.clone().set(x, y, z) }
  }

  #wantsAtlas(): boolean {
    return this.camera.view === 'free' || !this.camera.hasBackground
  }

  #showLightWeight(lightIndex: number, weight: number): void {
    this.#weights[lightIndex] = weight
    this.#renderer.setLightWeights(this.#weights)
    this.#controls?.setLightWeight(lightIndex, weight)
    this.requestFrame()
  }

  #takeConnectionState(state: ConnectionState): void {
    if (state.kind === 'live' && this.#connectionState.kind !== 'live') {
      this.feed.reset()
    }
    this.#connectionState = state
    this.#onConnectionState(state)
  }

  #takeControlState(state: ControlState): void {
    if (!this.#hasControlState) {
      // The lamps may be dimmed already: the first picture with their real weights sets the exposure.
      this.#hasControlState = true
      this.#exposureDue = this.#picture.autoExposure && !this.#options.evaluate
      this.requestFrame()
    }
    state.lightWeights.forEach((weight, index) => {
      const isKnown = index < this.#weights.length
      if (isKnown && Math.fround(weight) !== this.#weights[index] && !this.#outbox.isLightUnsettled(index)) {
        this.#showLightWeight(index, weight)
      }
    })
    state.objectPoses.forEach((pose, index) => {
      this.objects.applyServerPose(index, pose)
    })
  }
}

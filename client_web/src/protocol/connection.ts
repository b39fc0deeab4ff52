// The page's side of the connection: a worker that holds the socket, and the page events that wake it.

import type { FromWorker, ToWorker } from './connection.worker'
import type { ConnectionState } from './connectionLoop'
import type { LightPacket } from './lightPacket'
import type { AtlasTiles, ControlState, Status } from './messages'

export type { ConnectionState } from './connectionLoop'

export interface ConnectionEvents {
  state(state: ConnectionState): void
  light(packet: LightPacket, numBytes: number): void
  atlas(tiles: AtlasTiles): void
  controlState(state: ControlState): void
  status(status: Status): void
  /** A message that could not be read was left out. */
  refused(text: string): void
}

/** The part of Worker that is used. */
export interface WorkerPort {
  onmessage: ((event: MessageEvent<FromWorker>) => void) | null
  postMessage(message: ToWorker): void
  terminate(): void
}

/** The part of the page that is used. */
export interface PageEvents {
  addEventListener(type: string, listener: () => void): void
  removeEventListener(type: string, listener: () => void): void
}

/** The websocket beside this page: same host and folder, ws for http and wss for https. */
export function websocketUrl(pageUrl: string): string {
  const url = new URL('ws', pageUrl)
  url.protocol = url.protocol === 'https:' ? 'wss:' : 'ws:'
  url.search = ''
  url.hash = ''
  return url.href
}

function createWorker(): WorkerPort {
  return new Worker(new URL('./connection.worker.ts', import.meta.url), { type: 'module' }) as WorkerPort
}

/** A connection that reopens itself until it is disposed of or the server says that coming back is pointless. */
export class ServerConnection {
  readonly #worker: WorkerPort
  readonly #listeners: readonly [PageEvents, string][]
  readonly #resume = (): void => this.#worker.postMessage({ type: 'resume' })

  constructor(
    events: ConnectionEvents,
    url: string = websocketUrl(document.baseURI),
    worker: WorkerPort = createWorker(),
    page: { window: PageEvents; document: PageEvents } = { window, document },
  ) {
    this.#worker = worker
    worker.onmessage = ({ data }) => dispatch(events, data)
    this.#listeners = [
      [page.document, 'visibilitychange'],
      [page.window, 'pageshow'],
      [page.window, 'online'],
    ]
    for (const [target, type] of this.#listeners) target.addEventListener(type, this.#resume)
    worker.postMessage({ type: 'start', url })
  }

  setLightWeight(lightIndex: number, weight: number): void {
    this.#worker.postMessage({ type: 'request', message: { type: 'setLightWeight', lightIndex, weight } })
  }

  setObjectPose(
    objectIndex: number,
    position: readonly [number, number, number],
    quaternion: readonly [number, number, number, number],
  ): void {
    const message = { type: 'setObjectPose', objectIndex, position, quaternion } as const
    this.#worker.postMessage({ type: 'request', message })
  }

  wantAtlas(wanted: boolean): void {
    const message = { type: 'subscribe', encoding: 1, wantsAtlas: wanted } as const
    this.#worker.postMessage({ type: 'request', message })
  }

  dispose(): void {
    for (const [target, type] of this.#listeners) target.removeEventListener(type, this.#resume)
    this.#worker.onmessage = null
    this.#worker.postMessage({ type: 'dispose' })
    this.#worker.terminate()
  }
}

function dispatch(events: ConnectionEvents, data: FromWorker): void {
  switch (data.type) {
    case 'state':
      events.state(data.state)
      return
    case 'refused':
      events.refused(data.text)
      return
    case 'message': {
      const { message } = data
      switch (message.type) {
        case 'light':
          events.light(message.packet, message.numBytes)
          return
        case 'atlas':
          events.atlas(message.tiles)
          return
        case 'controlState':
          events.controlState(message.state)
          return
        case 'status':
          events.status(message.status)
          return
      }
    }
  }
}

// Keeps a session alive over sockets that come and go. Socket, clock and chance are handed in, so that tests bring their own.

import { CloseCode, SUBPROTOCOL } from './layout.gen'
import type { ClientMessage } from './messages'
import { ClientSession, type ServerMessage } from './session'

export type ConnectionState =
  | { readonly kind: 'connecting' }
  | { readonly kind: 'live' }
  | { readonly kind: 'waiting'; readonly retryMs: number }
  | { readonly kind: 'closed'; readonly reason: 'version' | 'full' | 'other'; readonly text: string }

/** The part of WebSocket that is used. */
export interface Socket {
  binaryType: string
  onmessage: ((event: { data: unknown }) => void) | null
  onclose: ((event: { code: number; reason: string }) => void) | null
  send(data: ArrayBuffer): void
  close(): void
}

export interface Environment {
  openSocket(url: string, subprotocol: string): Socket
  nowMs(): number
  setTimeout(callback: () => void, delayMs: number): number
  clearTimeout(handle: number): void
  /** In [0, 1). */
  random(): number
}

export interface LoopEvents {
  state(state: ConnectionState): void
  message(message: ServerMessage): void
  /** A message that could not be read was left out. */
  refused(text: string): void
}

export const FIRST_RETRY_MS = 500
export const LAST_RETRY_MS = 8000
export const CONNECT_TIMEOUT_MS = 5000
/** The server speaks at least every second. */
export const SILENCE_TIMEOUT_MS = 5000
const TICK_MS = 50
/** On waking up (another tab, another network) a connection that was silent for so long is not trusted. */
const RESUME_SILENCE_MS = 2000

export class ConnectionLoop {
  readonly #session = new ClientSession()
  readonly #url: string
  readonly #events: LoopEvents
  readonly #environment: Environment
  #socket: Socket | null = null
  #isLive = false
  #isClosed = false
  #attempts = 0
  #startedMs = 0
  #retryTimer: number | null = null
  #tickTimer: number | null = null

  constructor(url: string, events: LoopEvents, environment: Environment) {
    this.#url = url
    this.#events = events
    this.#environment = environment
  }

  start(): void {
    this.#connect()
  }

  request(message: ClientMessage): void {
    this.#session.request(message)
    this.#flush()
  }

  /** The page came to the front, was restored, or the network came back: try now instead of later. */
  resume(): void {
    if (this.#isClosed) return
    const { nowMs } = this.#environment
    if (this.#socket !== null) {
      if (!this.#isLive || nowMs() - this.#session.heardMs < RESUME_SILENCE_MS) return
      this.#drop()
    }
    this.#attempts = 0
    this.#connect()
  }

  dispose(): void {
    this.#isClosed = true
    this.#drop()
  }

  #connect(): void {
    this.#drop()
    this.#events.state({ kind: 'connecting' })
    this.#startedMs = this.#environment.nowMs()
    let socket: Socket
    try {
      socket = this.#environment.openSocket(this.#url, SUBPROTOCOL)
    } catch (error) {
      this.#end('other', `The browser refuses to connect to ${this.#url}: ${(error as Error).message}`)
      return
    }
    socket.binaryType = 'arraybuffer'
    socket.onmessage = (event) => this.#receive(event.data)
    socket.onclose = (event) => this.#closed(event.code, event.reason)
    this.#socket = socket
    this.#tick()
  }

  #receive(data: unknown): void {
    const nowMs = this.#environment.nowMs()
    if (!this.#isLive) {
      // Not before the first message: a server of another version accepts too, to say why it closes.
      this.#isLive = true
      this.#attempts = 0
      this.#session.open(nowMs)
      this.#events.state({ kind: 'live' })
    }
    let message: ServerMessage | null = null
    try {
      if (!(data instanceof ArrayBuffer)) throw new TypeError('expected a binary message, found text')
      message = this.#session.receive(data, nowMs)
    } catch (error) {
      this.#events.refused((error as Error).message)
    }
    this.#flush()
    if (message !== null) this.#events.message(message)
  }

  #closed(code: number, reason: string): void {
    this.#drop()
    if (code === CloseCode.VERSION_MISMATCH) {
      this.#end('version', reason || 'The page and the server speak different versions: reload the page')
    } else if (code === CloseCode.SERVER_FULL) {
      this.#end('full', reason || 'As many tablets as this server allows are connected')
    } else if (code === CloseCode.MALFORMED_MESSAGE) {
      this.#end('other', reason || 'The server could not read a message of this page')
    } else {
      this.#retry()
    }
  }

  #end(reason: 'version' | 'full' | 'other', text: string): void {
    // A full server may have room later; the page may ask again by making a new connection.
    this.#isClosed = true
    this.#events.state({ kind: 'closed', reason, text })
  }

  #retry(): void {
    const longest = Math.min(LAST_RETRY_MS, FIRST_RETRY_MS * 2 ** this.#attempts)
    this.#attempts++
    // Between half and all of it: many tablets must not come back at the same moment.
    const retryMs = Math.round(longest * (0.5 + 0.5 * this.#environment.random()))
    this.#events.state({ kind: 'waiting', retryMs })
    this.#retryTimer = this.#environment.setTimeout(() => this.#connect(), retryMs)
  }

  #tick(): void {
    this.#tickTimer = this.#environment.setTimeout(() => {
      const nowMs = this.#environment.nowMs()
      const silentSince = this.#isLive ? this.#session.heardMs : this.#startedMs
      const limit = this.#isLive ? SILENCE_TIMEOUT_MS : CONNECT_TIMEOUT_MS
      if (nowMs - silentSince > limit) {
        this.#drop()
        this.#retry()
        return
      }
      this.#flush()
      this.#tick()
    }, TICK_MS)
  }

  #flush(): void {
    if (this.#socket === null || !this.#isLive) return
    for (const data of this.#session.takeOutgoing(this.#environment.nowMs())) this.#socket.send(data)
  }

  /** Let go of the socket and of all timers. */
  #drop(): void {
    for (const timer of [this.#retryTimer, this.#tickTimer]) {
      if (timer !== null) this.#environment.clearTimeout(timer)
    }
    this.#retryTimer = null
    this.#tickTimer = null
    this.#isLive = false
    const socket = this.#socket
    this.#socket = null
    if (socket !== null) {
      socket.onmessage = null
      socket.onclose = null
      socket.close()
    }
  }
}

// The client's end of a connection as a state machine: no socket, no clock, no timer (protocol/SPEC.md, "Flow").

import { DecodeError } from './errors'
import { peekHeader } from './framing'
import { Encoding, MessageType } from './layout.gen'
import { decodeLightPacket, type LightPacket } from './lightPacket'
import {
  type AtlasTiles,
  type ClientMessage,
  type ControlState,
  decodeAtlasTiles,
  decodeControlState,
  decodeStatus,
  encodeClientMessage,
  type Status,
} from './messages'

export type ServerMessage =
  | { readonly type: 'light'; readonly packet: LightPacket; readonly numBytes: number }
  | { readonly type: 'atlas'; readonly tiles: AtlasTiles }
  | { readonly type: 'controlState'; readonly state: ControlState }
  | { readonly type: 'status'; readonly status: Status }

/** Requests per second; the server closes connections above 20. */
const REQUESTS_PER_SECOND = 18
const REQUEST_BURST = 10
/** The server speaks at least every second; if it does not, requests would only pile up on the way to it. */
const SILENCE_MS = 1500

export class ClientSession {
  readonly #acknowledgements: ArrayBuffer[] = []
  /** Newest request per object or light, in the order in which they began to wait. */
  readonly #requests = new Map<string, ClientMessage>()
  #wantsAtlas = false
  #subscriptionDue = false
  #sequence = 0
  #tokens = REQUEST_BURST
  #tokensMs = Number.NEGATIVE_INFINITY
  #heardMs = Number.NEGATIVE_INFINITY

  /** When the server was last heard, on the clock of the caller. */
  get heardMs(): number {
    return this.#heardMs
  }

  /** A connection opened: forget what belonged to the former one. Requests that wait are kept. */
  open(nowMs: number): void {
    this.#acknowledgements.length = 0
    this.#subscriptionDue = this.#wantsAtlas
    this.#sequence = 0
    this.#tokens = REQUEST_BURST
    this.#tokensMs = nowMs
    this.#heardMs = nowMs
  }

  /** Take a message; an acknowledgement is queued where one is due. Throws DecodeError. */
  receive(buffer: ArrayBuffer, nowMs: number): ServerMessage {
    const { messageType, sequence } = peekHeader(buffer)
    this.#heardMs = nowMs
    switch (messageType) {
      case MessageType.LIGHT_PACKET:
        // Acknowledged even if it cannot be read: the next one may be readable.
        this.#acknowledge(messageType, sequence)
        return { type: 'light', packet: decodeLightPacket(buffer), numBytes: buffer.byteLength }
      case MessageType.ATLAS_TILES:
        this.#acknowledge(messageType, sequence)
        return { type: 'atlas', tiles: decodeAtlasTiles(buffer) }
      case MessageType.CONTROL_STATE:
        return { type: 'controlState', state: decodeControlState(buffer) }
      case MessageType.STATUS:
        return { type: 'status', status: decodeStatus(buffer) }
      default:
        throw new DecodeError('message_type', 6, 'a message from a server', messageType)
    }
  }

  wantAtlas(wanted: boolean): void {
    this.#subscriptionDue = this.#subscriptionDue || wanted !== this.#wantsAtlas
    this.#wantsAtlas = wanted
  }

  /** Ask for something; a newer request for the same object or light replaces a waiting one. */
  request(message: ClientMessage): void {
    switch (message.type) {
      case 'setObjectPose':
        this.#requests.set(`object ${message.objectIndex}`, message)
        break
      case 'setLightWeight':
        this.#requests.set(`light ${message.lightIndex}`, message)
        break
      case 'subscribe':
        this.wantAtlas(message.wantsAtlas)
        break
    }
  }

  /** What to send now, oldest first; handed out once. */
  takeOutgoing(nowMs: number): ArrayBuffer[] {
    const outgoing = this.#acknowledgements.splice(0)
    const earned = ((nowMs - this.#tokensMs) / 1000) * REQUESTS_PER_SECOND
    this.#tokens = Math.min(this.#tokens + Math.max(earned, 0), REQUEST_BURST)
    this.#tokensMs = nowMs
    if (nowMs - this.#heardMs > SILENCE_MS) return outgoing
    if (this.#subscriptionDue && this.#tokens >= 1) {
      this.#tokens--
      this.#subscriptionDue = false
      outgoing.push(
        this.#encode({ type: 'subscribe', encoding: Encoding.COMPACT, wantsAtlas: this.#wantsAtlas }),
      )
    }
    for (const [key, message] of this.#requests) {
      if (this.#tokens < 1) break
      this.#tokens--
      this.#requests.delete(key)
      outgoing.push(this.#encode(message))
    }
    return outgoing
  }

  #acknowledge(acknowledgedType: MessageType, acknowledgedSequence: number): void {
    this.#acknowledgements.push(this.#encode({ type: 'ack', acknowledgedType, acknowledgedSequence }))
  }

  #encode(message: ClientMessage): ArrayBuffer {
    this.#sequence = (this.#sequence + 1) >>> 0
    return encodeClientMessage(message, this.#sequence)
  }
}

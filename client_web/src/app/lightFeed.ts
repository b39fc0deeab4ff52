/** The newest light and what is known about it: age, size, rate. */
import type { LightPacket, Status } from '../protocol/codec'
import { type LightFrame, LightState, type LightStateOptions } from '../state/lightState'
import { ServerClock } from '../state/serverClock'

/** A heartbeat comes every second at the latest; as long as they come, what they report goes on. */
const HEARTBEAT_MS = 1250

interface Waiter {
  readonly sequence: number
  readonly resolve: () => void
}

export class LightFeed {
  readonly #light: LightState
  readonly #clock = new ServerClock()
  readonly #staleAfterMs: number
  readonly #waiters: Waiter[] = []
  #timestampNs: bigint | null = null
  #status: { ageMs: number; isStale: boolean; receivedMs: number } | null = null
  #numVals = 0
  #packetBytes = 0
  #lastPacketMs = 0
  #revision = -1

  constructor(staleAfterMs: number, options: LightStateOptions) {
    this.#light = new LightState(options)
    this.#staleAfterMs = staleAfterMs
  }

  get sequence(): number | undefined {
    return this.#light.sequence
  }

  get fading(): boolean {
    return this.#light.fading
  }

  /** VALs that are not dark in the newest packet. */
  get numVals(): number {
    return this.#numVals
  }

  get packetBytes(): number {
    return this.#packetBytes
  }

  get timestampNs(): bigint | null {
    return this.#timestampNs
  }

  /** A new session: other sequences, perhaps another clock. */
  reset(): void {
    this.#light.reset()
    this.#clock.reset()
    this.#status = null
  }

  /** @returns whether the packet was the newest. */
  push(packet: LightPacket, numBytes: number, nowMs: number): boolean {
    if (!this.#light.push(packet, nowMs)) {
      return false
    }
    this.#timestampNs = packet.timestampNs
    this.#packetBytes = numBytes
    this.#lastPacketMs = nowMs
    this.#numVals = countLit(packet)
    return true
  }

  observeStatus(status: Status, nowMs: number): void {
    this.#clock.observe(status.serverTimeNs, nowMs)
    // The newest camera picture is behind the light also where the light did not change and no packet was sent.
    const cameraAges = status.cameraAges.filter(Number.isFinite)
    const age = cameraAges.length > 0 ? Math.min(...cameraAges) : status.lightAge
    this.#status = { ageMs: 1000 * age, isStale: status.isStale, receivedMs: nowMs }
  }

  /** Age of the newest camera picture behind the light, ms, or null while it is not known. */
  ageMs(nowMs: number): number | null {
    const byPacket = this.#timestampNs === null ? null : this.#clock.ageMs(this.#timestampNs, nowMs)
    const byStatus =
      this.#status && Number.isFinite(this.#status.ageMs)
        ? this.#status.ageMs + Math.max(0, nowMs - this.#status.receivedMs - HEARTBEAT_MS)
        : null
    // The server repeats light that stays the same only now and then; then its own word is the newer one.
    return byPacket !== null && byStatus !== null ? Math.min(byPacket, byStatus) : (byPacket ?? byStatus)
  }

  isStale(nowMs: number): boolean {
    const age = this.ageMs(nowMs)
    return (this.#status?.isStale ?? false) || (age !== null && age > this.#staleAfterMs)
  }

  /** Updates per second; 0 when none came for two seconds. */
  updatesPerSecond(nowMs: number): number {
    const interval = this.#light.updateIntervalMs
    return interval > 0 && nowMs - this.#lastPacketMs < 2000 ? 1000 / interval : 0
  }

  /** The light to show, or null when it is what the last call returned. */
  next(nowMs: number): LightFrame | null {
    const frame = this.#light.sample(nowMs)
    if (frame.revision === this.#revision) {
      return null
    }
    this.#revision = frame.revision
    return frame
  }

  /** Called after a frame was drawn: lets those go on who wait for it. */
  settle(): void {
    const sequence = this.#light.sequence
    if (sequence === undefined || this.#light.fading) {
      return
    }
    for (let i = this.#waiters.length - 1; i >= 0; i--) {
      const waiter = this.#waiters[i] as Waiter
      if (((sequence - waiter.sequence) | 0) >= 0) {
        this.#waiters.splice(i, 1)
        waiter.resolve()
      }
    }
  }

  /** Resolves once the light of this sequence, or a newer one, is drawn and its cross-fade is over. */
  waitFor(sequence: number): Promise<void> {
    return new Promise((resolve) => {
      this.#waiters.push({ sequence, resolve })
    })
  }
}

function countLit(packet: LightPacket): number {
  let count = 0
  for (let slot = 0; slot < packet.numVals; slot++) {
    const at = 16 * slot + 8
    count += packet.vals[at] || packet.vals[at + 1] || packet.vals[at + 2] ? 1 : 0
  }
  return count
}

/**
 * The server's clock, read from its heartbeats. Messages are only ever late, never early, so the heartbeat that gives
 * the most advanced clock was the least delayed one.
 */
export class ServerClock {
  readonly #offsets: number[] = []
  readonly #window: number

  /** @param window heartbeats that are remembered; clocks drift, so old ones must go. */
  constructor(window = 60) {
    this.#window = window
  }

  /** Notes a heartbeat: server time (ns) and the local time of its arrival (ms). */
  observe(serverTimeNs: bigint, receivedMs: number): void {
    this.#offsets.push(Number(serverTimeNs / 1000n) / 1000 - receivedMs)
    if (this.#offsets.length > this.#window) {
      this.#offsets.shift()
    }
  }

  /** Forgets everything, after a new session: the server may be another one. */
  reset(): void {
    this.#offsets.length = 0
  }

  /** Age of something that the server captured, ms, or null before the first heartbeat. */
  ageMs(timestampNs: bigint, nowMs: number): number | null {
    if (this.#offsets.length === 0) {
      return null
    }
    const offset = Math.max(...this.#offsets)
    return Math.max(0, nowMs + offset - Number(timestampNs / 1000n) / 1000)
  }
}

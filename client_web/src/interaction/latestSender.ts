/** The part of the browser that a sender needs; tests bring their own clock. */
export interface Timers {
  now(): number
  setTimeout(callback: () => void, delayMs: number): number
  clearTimeout(handle: number): void
}

export const browserTimers: Timers = {
  now: () => performance.now(),
  setTimeout: (callback, delayMs) => window.setTimeout(callback, delayMs),
  clearTimeout: (handle) => window.clearTimeout(handle),
}

/**
 * Sends the newest value per key, at most one value of all keys per interval: the server counts messages per client.
 * The first value goes at once, the last of every key always goes, and keys take turns.
 */
export class LatestSender<Key, Value> {
  readonly #intervalMs: number
  readonly #send: (key: Key, value: Value) => void
  readonly #timers: Timers
  readonly #sentAt = new Map<Key, number>()
  /** In the order in which the keys began to wait. */
  readonly #waiting = new Map<Key, Value>()
  #lastSent = Number.NEGATIVE_INFINITY
  #timer: number | null = null

  constructor(intervalMs: number, send: (key: Key, value: Value) => void, timers: Timers = browserTimers) {
    this.#intervalMs = intervalMs
    this.#send = send
    this.#timers = timers
  }

  offer(key: Key, value: Value): void {
    this.#waiting.set(key, value)
    if (this.#timer === null) {
      this.#sendOrWait()
    }
  }

  /** Whether a value waits, or one was sent so recently that the server's answer to it may be on its way. */
  isBusy(key: Key, settleMs: number): boolean {
    const sentAt = this.#sentAt.get(key)
    return this.#waiting.has(key) || (sentAt !== undefined && this.#timers.now() - sentAt < settleMs)
  }

  dispose(): void {
    this.#waiting.clear()
    if (this.#timer !== null) {
      this.#timers.clearTimeout(this.#timer)
      this.#timer = null
    }
  }

  #sendOrWait(): void {
    this.#timer = null
    const next = this.#waiting.entries().next()
    if (next.done) {
      return
    }
    const now = this.#timers.now()
    const due = this.#lastSent + this.#intervalMs
    if (now >= due) {
      const [key, value] = next.value
      this.#waiting.delete(key)
      this.#lastSent = now
      this.#sentAt.set(key, now)
      this.#send(key, value)
    }
    if (this.#waiting.size > 0) {
      const delay = Math.max(0, this.#lastSent + this.#intervalMs - now)
      this.#timer = this.#timers.setTimeout(() => this.#sendOrWait(), delay)
    }
  }
}

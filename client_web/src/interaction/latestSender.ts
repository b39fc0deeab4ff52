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
 * Sends the newest value per key, at most once per interval. The first value goes at once and the last one always goes.
 */
export class LatestSender<Key, Value> {
  readonly #intervalMs: number
  readonly #send: (key: Key, value: Value) => void
  readonly #timers: Timers
  readonly #lastSent = new Map<Key, number>()
  readonly #waiting = new Map<Key, { value: Value; handle: number }>()

  constructor(intervalMs: number, send: (key: Key, value: Value) => void, timers: Timers = browserTimers) {
    this.#intervalMs = intervalMs
    this.#send = send
    this.#timers = timers
  }

  offer(key: Key, value: Value): void {
    const waiting = this.#waiting.get(key)
    if (waiting) {
      waiting.value = value
      return
    }
    const now = this.#timers.now()
    const due = (this.#lastSent.get(key) ?? Number.NEGATIVE_INFINITY) + this.#intervalMs
    if (now >= due) {
      this.#lastSent.set(key, now)
      this.#send(key, value)
      return
    }
    const handle = this.#timers.setTimeout(() => this.#flush(key), due - now)
    this.#waiting.set(key, { value, handle })
  }

  /** Whether a value waits, or one was sent so recently that the server's answer to it may be on its way. */
  isBusy(key: Key, settleMs: number): boolean {
    const last = this.#lastSent.get(key)
    return this.#waiting.has(key) || (last !== undefined && this.#timers.now() - last < settleMs)
  }

  dispose(): void {
    for (const { handle } of this.#waiting.values()) {
      this.#timers.clearTimeout(handle)
    }
    this.#waiting.clear()
  }

  #flush(key: Key): void {
    const waiting = this.#waiting.get(key)
    if (waiting) {
      this.#waiting.delete(key)
      this.#lastSent.set(key, this.#timers.now())
      this.#send(key, waiting.value)
    }
  }
}

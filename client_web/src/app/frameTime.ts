/** The usual time between frames: the median of the last ones, so that one long frame (a new shader) does not count. */
export class FrameTime {
  readonly #recent = new Float64Array(15)
  #count = 0

  observe(intervalMs: number): void {
    this.#recent[this.#count % this.#recent.length] = intervalMs
    this.#count++
  }

  /** Milliseconds, or null before the first frame that followed another. */
  get medianMs(): number | null {
    const held = Math.min(this.#count, this.#recent.length)
    const sorted = this.#recent.slice(0, held).sort()
    return sorted[held >> 1] ?? null
  }
}

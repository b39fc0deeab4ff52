/** Runs a callback per display frame while there is something to draw, and rests otherwise. */
export interface FrameScheduler {
  request(callback: (nowMs: number) => void): number
  cancel(handle: number): void
}

export const displayFrames: FrameScheduler = {
  request: (callback) => requestAnimationFrame(callback),
  cancel: (handle) => cancelAnimationFrame(handle),
}

export class FrameLoop {
  readonly #draw: (nowMs: number, sinceLastMs: number | null) => boolean
  readonly #frames: FrameScheduler
  #handle: number | null = null
  #lastMs: number | null = null
  #paused = false
  #wanted = false

  /**
   * @param draw draws one frame and returns whether another one must follow. It is told the time since the previous
   *   frame if that one followed directly, else null.
   */
  constructor(
    draw: (nowMs: number, sinceLastMs: number | null) => boolean,
    frames: FrameScheduler = displayFrames,
  ) {
    this.#draw = draw
    this.#frames = frames
  }

  /** Asks for a frame; several requests before it are one. */
  request(): void {
    this.#wanted = true
    if (!this.#paused && this.#handle === null) {
      this.#handle = this.#frames.request((nowMs) => this.#run(nowMs))
    }
  }

  /** Stops drawing, e.g. while the page is hidden; a request made meanwhile is kept. */
  pause(): void {
    this.#paused = true
    this.#lastMs = null
    if (this.#handle !== null) {
      this.#frames.cancel(this.#handle)
      this.#handle = null
    }
  }

  resume(): void {
    this.#paused = false
    if (this.#wanted) {
      this.request()
    }
  }

  #run(nowMs: number): void {
    this.#handle = null
    this.#wanted = false
    const sinceLast = this.#lastMs === null ? null : nowMs - this.#lastMs
    const more = this.#draw(nowMs, sinceLast)
    if (this.#paused) {
      return
    }
    if (more) {
      this.request()
    }
    this.#lastMs = this.#wanted ? nowMs : null
  }
}

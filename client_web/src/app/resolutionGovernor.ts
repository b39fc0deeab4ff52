/** Pixels per CSS pixel, from coarse to fine. */
export const RESOLUTION_STEPS = [0.5, 0.625, 0.75, 0.875, 1, 1.25, 1.5] as const

const SLOW_FRAME_MS = 40
const FAST_FRAME_MS = 20
const SLOW_FRAMES = 12
const FAST_FRAMES = 60
/** A finer step that was too slow is not tried again for so many frames. */
const RETRY_FRAMES = 1800

/**
 * Chooses the resolution from measured frame times. It goes down soon and up late, with a wide gap between both limits,
 * and remembers the step that was too fine, so that the picture does not switch to and fro.
 */
export class ResolutionGovernor {
  #step: number
  #limit: number
  #slow = 0
  #fast = 0
  #blockedStep: number = RESOLUTION_STEPS.length
  #blockedFrames = 0

  /** @param devicePixelRatio no step above it is used, since nobody would see it. */
  constructor(devicePixelRatio: number) {
    this.#limit = limitFor(devicePixelRatio)
    this.#step = Math.min(this.#limit, RESOLUTION_STEPS.indexOf(1))
  }

  get scale(): number {
    return RESOLUTION_STEPS[this.#step] as number
  }

  setDevicePixelRatio(ratio: number): void {
    this.#limit = limitFor(ratio)
    this.#step = Math.min(this.#step, this.#limit)
  }

  /** Takes the time between two frames that followed each other; returns whether the scale changed. */
  observe(frameMs: number): boolean {
    this.#blockedFrames = Math.max(0, this.#blockedFrames - 1)
    if (this.#blockedFrames === 0) {
      this.#blockedStep = RESOLUTION_STEPS.length
    }
    // One long frame is a hiccup (a first shader, a garbage collection), not the speed of the device.
    this.#slow = frameMs > SLOW_FRAME_MS ? this.#slow + 1 : Math.max(0, this.#slow - 1)
    this.#fast = frameMs < FAST_FRAME_MS ? this.#fast + 1 : 0
    if (this.#slow >= SLOW_FRAMES && this.#step > 0) {
      this.#blockedStep = this.#step
      this.#blockedFrames = RETRY_FRAMES
      return this.#go(this.#step - 1)
    }
    const finer = this.#step + 1
    if (this.#fast >= FAST_FRAMES && finer <= this.#limit && finer < this.#blockedStep) {
      return this.#go(finer)
    }
    return false
  }

  #go(step: number): boolean {
    this.#step = step
    this.#slow = 0
    this.#fast = 0
    return true
  }
}

function limitFor(devicePixelRatio: number): number {
  const most = Math.max(1, devicePixelRatio)
  return RESOLUTION_STEPS.filter((step) => step <= most + 1e-6).length - 1
}

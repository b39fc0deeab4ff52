/**
 * The light that is shown: the newest packet wins, and what is on the screen cross-fades to it.
 *
 * A light that kept its slot and generation is interpolated. A light that took over a slot fades in at its own place
 * while the former one fades out where it stood, so no light slides through the room and the summed radiant intensity
 * is linear in time. No array is allocated per frame.
 */

import type { LightFrame, LightInput, LightStateOptions } from './lightTypes'
import {
  at,
  copyPlace,
  FLOATS_PER_VAL,
  INTENSITY,
  isLit,
  mix,
  mixVal,
  NORMAL,
  placeDistance,
} from './valLayout'

/** Most lights on the screen, fading ones included: the renderer keeps one shadow tile for each. */
export const MAX_SHOWN_VALS = 64

const FREE = -1
const FADING_OUT = -2
/** Of a former session: shown unchanged until the next packet, then fading out. */
const ORPHANED = -3

export type { LightFrame, LightInput, LightStateOptions }

const DEFAULT_PLACE_TOLERANCE = 1e-3

const SHORTEST_FADE_MS = 80
const LONGEST_FADE_MS = 250

export class LightState {
  readonly #from = new Float32Array(MAX_SHOWN_VALS * FLOATS_PER_VAL)
  readonly #to = new Float32Array(MAX_SHOWN_VALS * FLOATS_PER_VAL)
  /** Where the renderer was last told that each light stands. */
  readonly #reported = new Float32Array(MAX_SHOWN_VALS * FLOATS_PER_VAL)
  readonly #placeTolerance: number
  readonly #scratch = new Float32Array(FLOATS_PER_VAL)
  /** Owner of each shown slot: slot of the packet, FREE or FADING_OUT. */
  readonly #packetSlot = new Int16Array(MAX_SHOWN_VALS).fill(FREE)
  readonly #shownSlot = new Int16Array(MAX_SHOWN_VALS).fill(FREE)
  readonly #generation = new Uint8Array(MAX_SHOWN_VALS)
  #shFrom = new Float32Array(0)
  #shTo = new Float32Array(0)
  readonly #fixedFadeMs: number | undefined
  #intervalMs = 0
  #fadeStart = 0
  #fadeMs = 0
  #fading = false
  #lastPushMs = 0
  #clockMs = 0
  #sequence: number | undefined
  #started = false
  #orphans = false
  readonly #frame: LightFrame = {
    vals: new Float32Array(MAX_SHOWN_VALS * FLOATS_PER_VAL),
    count: 0,
    objectSh: new Float32Array(0),
    positionsChanged: false,
    changedSlots: new Uint8Array(MAX_SHOWN_VALS),
    revision: 0,
  }

  constructor(options: LightStateOptions = {}) {
    this.#fixedFadeMs = options.fadeMs
    this.#placeTolerance = options.placeTolerance ?? DEFAULT_PLACE_TOLERANCE
  }

  /** Sequence of the newest packet, or undefined before the first. */
  get sequence(): number | undefined {
    return this.#sequence
  }

  /** Whether the next sample differs from the last one because a cross-fade goes on. */
  get fading(): boolean {
    return this.#fading
  }

  /** Measured time between updates, ms; 0 before the second. */
  get updateIntervalMs(): number {
    return this.#intervalMs
  }

  /**
   * Takes over a packet unless it is older than the newest one (sequences wrap at 2^32).
   *
   * @returns false when the packet was out of date.
   * @throws RangeError when the packet has more slots than can be shown.
   */
  push(packet: LightInput, timeMs: number): boolean {
    if (packet.numVals > MAX_SHOWN_VALS) {
      throw new RangeError(`light packet: expected at most ${MAX_SHOWN_VALS} slots, found ${packet.numVals}`)
    }
    if (this.#sequence !== undefined && ((packet.sequence - this.#sequence) | 0) <= 0) {
      return false
    }
    const nowMs = this.#advance(timeMs)
    this.#sequence = packet.sequence
    this.#measureInterval(nowMs)
    if (this.#started && !this.#orphans && !this.#differs(packet)) {
      return true
    }
    this.#freeze(this.#amount(nowMs))
    this.#orphans = false
    if (packet.objectSh.length !== this.#shTo.length) {
      // Another number of objects: there is nothing to fade from.
      this.#shTo = packet.objectSh.slice()
      this.#shFrom = packet.objectSh.slice()
    }
    for (let slot = 0; slot < MAX_SHOWN_VALS; slot++) {
      this.#retarget(packet, slot)
    }
    this.#settlePlaces()
    this.#shTo.set(packet.objectSh)
    this.#fadeMs = this.#started ? this.#nextFadeMs() : 0
    this.#fadeStart = nowMs
    this.#fading = true
    this.#started = true
    return true
  }

  /** After a new session: accepts any sequence, and trusts no slot to hold the light that it held before. */
  reset(): void {
    this.#sequence = undefined
    this.#lastPushMs = 0
    this.#shownSlot.fill(FREE)
    for (let shown = 0; shown < MAX_SHOWN_VALS; shown++) {
      if (this.#packetSlot[shown] !== FREE) {
        this.#packetSlot[shown] = ORPHANED
      }
    }
    this.#orphans = true
  }

  /** What to show now. The flags tell what differs from the previous call. */
  sample(timeMs: number): LightFrame {
    const nowMs = this.#advance(timeMs)
    const frame = this.#frame
    frame.positionsChanged = false
    frame.changedSlots.fill(0)
    if (!this.#fading) {
      return frame
    }
    const amount = this.#amount(nowMs)
    let changed = false
    let count = 0
    for (let shown = 0; shown < MAX_SHOWN_VALS; shown++) {
      if (this.#packetSlot[shown] === FREE) {
        continue
      }
      mixVal(this.#from, this.#to, shown * FLOATS_PER_VAL, amount, this.#scratch)
      count = shown + 1
      changed = this.#deliver(shown) || changed
    }
    changed = this.#mixSh(amount) || changed
    if (amount >= 1) {
      this.#fading = false
      count = this.#dropFaded()
    }
    if (changed || frame.count !== count) {
      frame.revision++
    }
    frame.count = count
    return frame
  }

  /** Frames are stamped with their start, packets with their arrival: time stands still rather than running backwards. */
  #advance(timeMs: number): number {
    if (timeMs > this.#clockMs && timeMs < Number.POSITIVE_INFINITY) {
      this.#clockMs = timeMs
    }
    return this.#clockMs
  }

  #amount(nowMs: number): number {
    if (this.#fadeMs <= 0) {
      return 1
    }
    return Math.min(1, Math.max(0, (nowMs - this.#fadeStart) / this.#fadeMs))
  }

  #nextFadeMs(): number {
    if (this.#fixedFadeMs !== undefined) {
      return this.#fixedFadeMs
    }
    return Math.min(LONGEST_FADE_MS, Math.max(SHORTEST_FADE_MS, this.#intervalMs))
  }

  #measureInterval(nowMs: number): void {
    if (this.#lastPushMs > 0) {
      const interval = nowMs - this.#lastPushMs
      // A pause (nothing changed for a while) says nothing about the rate of updates.
      if (interval < 1000) {
        this.#intervalMs = this.#intervalMs === 0 ? interval : 0.8 * this.#intervalMs + 0.2 * interval
      }
    }
    this.#lastPushMs = nowMs
  }

  /** Whether the packet asks for anything else than what is shown or being faded to. */
  #differs(packet: LightInput): boolean {
    if (packet.objectSh.length !== this.#shTo.length) {
      return true
    }
    for (let i = 0; i < this.#shTo.length; i++) {
      if (packet.objectSh[i] !== this.#shTo[i]) {
        return true
      }
    }
    for (let slot = 0; slot < MAX_SHOWN_VALS; slot++) {
      const shown = at(this.#shownSlot, slot)
      const lit = slot < packet.numVals && isLit(packet.vals, slot * FLOATS_PER_VAL + INTENSITY)
      if (shown === FREE) {
        if (lit) {
          return true
        }
      } else if (lit && packet.generations[slot] !== this.#generation[slot]) {
        return true
      } else if (!this.#equalsTarget(packet, slot, shown, lit)) {
        return true
      }
    }
    return false
  }

  #equalsTarget(packet: LightInput, slot: number, shown: number, lit: boolean): boolean {
    const base = shown * FLOATS_PER_VAL
    if (!lit) {
      return !isLit(this.#to, base + INTENSITY)
    }
    const source = slot * FLOATS_PER_VAL
    for (let i = 0; i < FLOATS_PER_VAL; i++) {
      if (packet.vals[source + i] !== this.#to[base + i]) {
        return false
      }
    }
    return true
  }

  /** Makes what is shown now the start of the next cross-fade. */
  #freeze(amount: number): void {
    for (let shown = 0; shown < MAX_SHOWN_VALS; shown++) {
      mixVal(this.#from, this.#to, shown * FLOATS_PER_VAL, amount, this.#scratch)
      this.#from.set(this.#scratch, shown * FLOATS_PER_VAL)
      if (this.#packetSlot[shown] === ORPHANED) {
        this.#fadeOut(shown)
      }
      if (this.#packetSlot[shown] === FADING_OUT && !isLit(this.#scratch, INTENSITY)) {
        this.#packetSlot[shown] = FREE
      }
    }
    for (let i = 0; i < this.#shTo.length; i++) {
      this.#shFrom[i] = mix(at(this.#shFrom, i), at(this.#shTo, i), amount)
    }
  }

  #retarget(packet: LightInput, slot: number): void {
    const lit = slot < packet.numVals && isLit(packet.vals, slot * FLOATS_PER_VAL + INTENSITY)
    const generation = slot < packet.numVals ? at(packet.generations, slot) : at(this.#generation, slot)
    let shown = at(this.#shownSlot, slot)
    if (shown !== FREE && generation !== this.#generation[slot]) {
      shown = this.#handOver(shown, lit)
    } else if (shown === FREE && lit) {
      shown = this.#allocate()
    }
    this.#generation[slot] = generation
    this.#shownSlot[slot] = shown
    if (shown === FREE) {
      return
    }
    this.#packetSlot[shown] = slot
    const base = shown * FLOATS_PER_VAL
    if (!lit) {
      this.#to.fill(0, base + INTENSITY, base + INTENSITY + 3)
      return
    }
    const source = slot * FLOATS_PER_VAL
    for (let i = 0; i < FLOATS_PER_VAL; i++) {
      this.#to[base + i] = at(packet.vals, source + i)
    }
  }

  /** The packet slot belongs to another light from now on: returns the shown slot of the new one. */
  #handOver(shown: number, lit: boolean): number {
    if (!isLit(this.#from, shown * FLOATS_PER_VAL + INTENSITY)) {
      return lit ? shown : this.#fadeOut(shown)
    }
    if (!lit) {
      return this.#fadeOut(shown)
    }
    const other = this.#allocate()
    if (other === FREE) {
      // Everything is in use: the place jumps, the radiant intensity still fades.
      this.#jump(shown)
      return shown
    }
    this.#fadeOut(shown)
    return other
  }

  #fadeOut(shown: number): typeof FREE {
    const base = shown * FLOATS_PER_VAL
    this.#packetSlot[shown] = FADING_OUT
    this.#to.fill(0, base + INTENSITY, base + INTENSITY + 3)
    return FREE
  }

  /** A dark slot, else the one that is fading out and has least radiant intensity, else FREE. */
  #allocate(): number {
    let dimmest = FREE
    let least = Number.POSITIVE_INFINITY
    for (let shown = 0; shown < MAX_SHOWN_VALS; shown++) {
      const base = shown * FLOATS_PER_VAL
      if (this.#packetSlot[shown] === FREE) {
        this.#from.fill(0, base, base + FLOATS_PER_VAL)
        this.#to.fill(0, base, base + FLOATS_PER_VAL)
        return shown
      }
      if (this.#packetSlot[shown] === FADING_OUT) {
        const remaining =
          at(this.#from, base + INTENSITY) +
          at(this.#from, base + INTENSITY + 1) +
          at(this.#from, base + INTENSITY + 2)
        if (remaining < least) {
          least = remaining
          dimmest = shown
        }
      }
    }
    if (dimmest !== FREE) {
      this.#jump(dimmest)
    }
    return dimmest
  }

  /** Marks the slot's start place as void, so that `#settlePlaces` takes the target's. */
  #jump(shown: number): void {
    const base = shown * FLOATS_PER_VAL
    this.#from.fill(0, base + NORMAL, base + NORMAL + 3)
  }

  /** A light that is dark at one end of the fade stands still where it is lit. */
  #settlePlaces(): void {
    for (let shown = 0; shown < MAX_SHOWN_VALS; shown++) {
      const base = shown * FLOATS_PER_VAL
      const startLit = isLit(this.#from, base + INTENSITY)
      if (!startLit || !isLit(this.#from, base + NORMAL)) {
        copyPlace(this.#to, this.#from, base)
      } else if (!isLit(this.#to, base + INTENSITY)) {
        copyPlace(this.#from, this.#to, base)
      }
    }
  }

  /** Copies the scratch slot to the frame and notes what differs. */
  #deliver(shown: number): boolean {
    const frame = this.#frame
    const base = shown * FLOATS_PER_VAL
    let changed = false
    for (let i = 0; i < FLOATS_PER_VAL; i++) {
      changed = changed || frame.vals[base + i] !== this.#scratch[i]
    }
    frame.vals.set(this.#scratch, base)
    if (changed && placeDistance(this.#scratch, this.#reported, base) > this.#placeTolerance) {
      // Compared with the place that was reported last, not with the last frame: small steps must add up.
      this.#reported.set(this.#scratch, base)
      frame.changedSlots[shown] = 1
      frame.positionsChanged = true
    }
    return changed
  }

  #mixSh(amount: number): boolean {
    const frame = this.#frame
    let changed = false
    if (frame.objectSh.length !== this.#shTo.length) {
      frame.objectSh = new Float32Array(this.#shTo.length)
      changed = true
    }
    for (let i = 0; i < this.#shTo.length; i++) {
      const before = frame.objectSh[i]
      frame.objectSh[i] = mix(at(this.#shFrom, i), at(this.#shTo, i), amount)
      changed = changed || frame.objectSh[i] !== before
    }
    return changed
  }

  /** Gives up slots whose light has gone; returns how many slots remain in use. */
  #dropFaded(): number {
    let count = 0
    for (let shown = 0; shown < MAX_SHOWN_VALS; shown++) {
      if (this.#packetSlot[shown] === FADING_OUT) {
        this.#packetSlot[shown] = FREE
      }
      if (this.#packetSlot[shown] !== FREE) {
        count = shown + 1
      }
    }
    return count
  }
}

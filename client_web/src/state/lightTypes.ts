/** What goes into the shown light and what comes out. */

/** The part of a decoded light packet that is shown. Slots without light have zero radiant intensity. */
export interface LightInput {
  readonly sequence: number
  readonly numVals: number
  /** `FLOATS_PER_VAL` per slot. */
  readonly vals: Float32Array
  readonly generations: Uint8Array
  /** 27 per object: sh_coeffs (9, 3), world axes. */
  readonly objectSh: Float32Array
}

/** What the renderer shows now. The same object is returned by every call of `sample`. */
export interface LightFrame {
  /** `FLOATS_PER_VAL` per slot. */
  readonly vals: Float32Array
  /** Slots to read; further ones are dark. */
  count: number
  objectSh: Float32Array
  /** Some slot's place left its tolerance since it was last reported: its shadow map is out of date. */
  positionsChanged: boolean
  /** 1 for those slots. */
  readonly changedSlots: Uint8Array
  /** Counts up whenever anything differs from the previous sample. */
  revision: number
}

export interface LightStateOptions {
  /** Fixed cross-fade time, ms; 0 switches at once. Without it: the measured time between updates. */
  readonly fadeMs?: number
  /**
   * How far a light may stray (metres, and as much in its normal and in the radius of its disc) before its shadow map
   * counts as out of date: measured lights tremble, and nobody sees a millimetre.
   */
  readonly placeTolerance?: number
}

/** Where soft shadows read their maps; points of the unit disc as read by chunks/shadow.glsl. */

const GOLDEN_ANGLE = Math.PI * (3 - Math.sqrt(5))

export interface Taps {
  /** 4 per tap: x, y, share, distance from the centre. */
  readonly search: Float32Array
  readonly numSearch: number
  /** 2 per tap. */
  readonly filter: Float32Array
  readonly numFilter: number
}

/**
 * @param numSearch taps that look for blockers: denser towards the centre, where alone blockers close to the receiver are found; the
 * share makes up for the density.
 * @param numFilter taps that compare: equal shares of the disc (Vogel's spiral), from the centre outwards.
 */
export function makeTaps(numSearch: number, numFilter: number): Taps {
  const search = Array.from({ length: numSearch }, (_, i) => {
    const t = (i + 0.25) / numSearch
    const angle = i * GOLDEN_ANGLE
    return [t * t * Math.cos(angle), t * t * Math.sin(angle), t ** 3, t * t]
  })
  const filter = Array.from({ length: numFilter }, (_, i) => {
    const r = Math.sqrt((i + 0.5) / numFilter)
    return [r * Math.cos(i * GOLDEN_ANGLE), r * Math.sin(i * GOLDEN_ANGLE)]
  })
  return {
    search: Float32Array.from(search.flat()),
    numSearch,
    filter: Float32Array.from(filter.flat()),
    numFilter,
  }
}

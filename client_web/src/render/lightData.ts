/** Packs VALs and their shadow windows for the shaders; rows as read by chunks/val_data.glsl. */
import { FLOATS_PER_VAL, MAX_VALS } from '../radiometry/valLight'
import type { ShadowFit } from './shadowFit'

/** Eight of the VAL itself, four with the open shares of up to 16 objects. */
export const VAL_COLUMNS = 12
const OPEN_SHARE_COLUMN = 8

/**
 * @param vals FLOATS_PER_VAL per slot.
 * @param fits window of the map as it was last drawn, or null where there is none.
 * @param openShares by object, then slot: what the fixture of each VAL leaves visible.
 */
export function packVals(
  vals: ArrayLike<number>,
  count: number,
  fits: readonly (ShadowFit | null)[],
  openShares: readonly Float32Array[],
): Float32Array {
  const data = new Float32Array(MAX_VALS * VAL_COLUMNS * 4)
  for (let slot = 0; slot < count; slot++) {
    const from = slot * FLOATS_PER_VAL
    const at = (offset: number): number => vals[from + offset] ?? 0
    const fit = fits[slot] ?? null
    data.set(
      [
        ...[at(0), at(1), at(2), at(3)],
        ...[at(4), at(5), at(6), Math.sqrt(at(3) / Math.PI)],
        ...[at(8), at(9), at(10), meanOf(openShares.map((shares) => shares[slot] ?? 1))],
        ...(fit ? [...fit.right, fit.scale[0]] : [1, 0, 0, 1]),
        ...(fit ? [...fit.up, fit.scale[1]] : [0, 1, 0, 1]),
        ...(fit ? [...fit.axis, 1] : [0, 0, 1, 0]),
        ...(fit ? [...fit.offset, fit.nearestCaster, 0] : [0, 0, 1, 0]),
      ],
      slot * VAL_COLUMNS * 4,
    )
    openShares.forEach((shares, object) => {
      data[(slot * VAL_COLUMNS + OPEN_SHARE_COLUMN) * 4 + object] = shares[slot] ?? 1
    })
  }
  return data
}

function meanOf(values: readonly number[]): number {
  return values.length === 0 ? 1 : values.reduce((sum, value) => sum + value, 0) / values.length
}

/** Exposure that suits a picture: its 98th percentile of luminance becomes 0.9. */

const PERCENTILE = 0.98
const TARGET = 0.9
/** Enough samples for a percentile that is steady to the eye, few enough for a tablet. */
const MAX_SAMPLES = 20_000
/** The smallest half float, which pictures are made of: what is darker is black. */
const BLACK = 2 ** -24
/** Luminance of linear Rec. 709 primaries (ITU-R BT.709). */
const LUMINANCE = [0.2126, 0.7152, 0.0722] as const

/**
 * @param rgba linear radiance, 4 floats per pixel.
 * @returns factor on radiance, or null for a black picture.
 */
export function suitableExposure(rgba: Float32Array): number | null {
  const pixels = Math.floor(rgba.length / 4)
  const stride = Math.max(1, Math.ceil(pixels / MAX_SAMPLES))
  const luminance = new Float32Array(Math.ceil(pixels / stride))
  let count = 0
  for (let pixel = 0; pixel < pixels; pixel += stride) {
    const value =
      LUMINANCE[0] * (rgba[4 * pixel] as number) +
      LUMINANCE[1] * (rgba[4 * pixel + 1] as number) +
      LUMINANCE[2] * (rgba[4 * pixel + 2] as number)
    if (Number.isFinite(value)) {
      luminance[count] = value
      count++
    }
  }
  const sorted = luminance.subarray(0, count).sort()
  const bright = sorted[Math.min(count - 1, Math.floor(PERCENTILE * count))] ?? 0
  return bright > BLACK ? TARGET / bright : null
}

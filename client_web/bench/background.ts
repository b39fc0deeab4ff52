/** The camera picture as one texture, for renderers that know no basis pictures. */
import { DataTexture, DataUtils, HalfFloatType, RGBAFormat } from 'three'
import type { BenchScene } from './scene'

/** Half floats, bottom row first: sum of weight * radiance / basis radiance * basis picture, at nominal weights. */
export function mixBackground({ view, assets }: BenchScene): DataTexture {
  const mixed = new Float32Array(4 * view.width * view.height)
  view.pictures.forEach(({ data }, k) => {
    const light = assets.lights[k]
    const scale = light ? light.weight / light.basisRadiance : 1
    const factors = [...(light?.radiance ?? [1, 1, 1]).map((value) => value * scale), 0]
    for (let i = 0; i < mixed.length; i++) {
      mixed[i] = (mixed[i] ?? 0) + (factors[i % 4] ?? 0) * DataUtils.fromHalfFloat(data[i] ?? 0)
    }
  })
  const texture = new DataTexture(
    Uint16Array.from(mixed, (value) => DataUtils.toHalfFloat(value)),
    view.width,
    view.height,
    RGBAFormat,
    HalfFloatType,
  )
  texture.needsUpdate = true
  return texture
}

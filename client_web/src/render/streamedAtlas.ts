/** The streamed radiance of the room, kept so that a lost context can be filled again. */
import type { AtlasTiles } from '../protocol/codec'
import type { GpuState } from './gpuState'

/** Side of a streamed atlas tile, texels. */
const ATLAS_TILE = 32

export class StreamedAtlas {
  readonly #tiles = new Map<number, Uint32Array>()
  #size = { width: 0, height: 0 }

  /** Takes over tiles and uploads them. */
  update(tiles: AtlasTiles, gpu: GpuState): void {
    if (tiles.width !== this.#size.width || tiles.height !== this.#size.height) {
      this.#tiles.clear()
      this.#size = { width: tiles.width, height: tiles.height }
    }
    const texelsPerTile = ATLAS_TILE * ATLAS_TILE
    for (let i = 0; 2 * i + 1 < tiles.positions.length; i++) {
      const column = tiles.positions[2 * i] ?? 0
      const row = tiles.positions[2 * i + 1] ?? 0
      const texels = tiles.texels.slice(i * texelsPerTile, (i + 1) * texelsPerTile)
      this.#tiles.set(row * tiles.width + column, texels)
      this.#upload(gpu, column, row, texels)
    }
  }

  /** Uploads everything to a new context. */
  restore(gpu: GpuState): void {
    for (const [key, texels] of this.#tiles) {
      this.#upload(gpu, key % this.#size.width, Math.floor(key / this.#size.width), texels)
    }
  }

  #upload(gpu: GpuState, column: number, row: number, texels: Uint32Array): void {
    const { width, height } = this.#size
    gpu.writeAtlas(width, height, column * ATLAS_TILE, row * ATLAS_TILE, ATLAS_TILE, texels)
  }
}

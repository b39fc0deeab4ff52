/** Keeps the shadow maps of all VALs up to date within the budget of a frame. */
import { FLOATS_PER_VAL, MAX_VALS } from '../radiometry/valLight'
import { fitShadowMap, type ShadowFit, type Sphere, sameFit } from './shadowFit'
import { ShadowSchedule, type ShadowWork } from './shadowSchedule'
import type { Vec3 } from './vector'

/** Tiles of each layer that one frame may draw while the picture is live. */
export const LIVE_MAPS_PER_FRAME = 16

export class ShadowMaps {
  readonly #schedule = new ShadowSchedule(MAX_VALS)
  readonly #wanted: (ShadowFit | null)[] = Array(MAX_VALS).fill(null)
  /** Windows of the maps as they are in the atlas. */
  readonly #drawn: (ShadowFit | null)[] = Array(MAX_VALS).fill(null)
  #vals: Float32Array = new Float32Array(0)

  get drawn(): readonly (ShadowFit | null)[] {
    return this.#drawn
  }

  get pending(): boolean {
    return this.#schedule.pending
  }

  position(slot: number): Vec3 {
    const base = slot * FLOATS_PER_VAL
    return [this.#vals[base] ?? 0, this.#vals[base + 1] ?? 0, this.#vals[base + 2] ?? 0]
  }

  /** All maps have to be drawn again: another atlas, or a new context. */
  invalidate(): void {
    this.#drawn.fill(null)
    for (let slot = 0; slot < MAX_VALS; slot++) {
      if (this.#wanted[slot]) {
        this.#schedule.valChanged(slot)
      }
    }
  }

  /**
   * Takes over the VALs and objects of the coming frame.
   *
   * @param changedSlots 1 where position, normal or area changed, or null for all.
   */
  update(
    vals: Float32Array,
    count: number,
    changedSlots: Uint8Array | null,
    spheres: readonly Sphere[],
    objectsMoved: boolean,
  ): void {
    this.#vals = vals
    for (let slot = 0; slot < MAX_VALS; slot++) {
      const at = (offset: number): number => vals[slot * FLOATS_PER_VAL + offset] ?? 0
      const isLit = slot < count && (at(8) > 0 || at(9) > 0 || at(10) > 0)
      const before = this.#wanted[slot] ?? null
      const wanted = isLit
        ? fitShadowMap(this.position(slot), [at(4), at(5), at(6)], Math.sqrt(at(3) / Math.PI), spheres)
        : null
      this.#wanted[slot] = wanted
      if (!wanted) {
        this.#drawn[slot] = null
      } else if (changedSlots === null || changedSlots[slot] === 1 || before === null) {
        this.#schedule.valChanged(slot)
      } else if (!sameFit(before, wanted)) {
        this.#schedule.fitChanged(slot)
      } else if (objectsMoved) {
        this.#schedule.objectsChanged(slot)
      }
    }
  }

  /** The maps to draw now; they count as drawn. */
  take(limit: number): ShadowWork[] {
    const work = this.#schedule.take(limit)
    for (const { slot } of work) {
      this.#drawn[slot] = this.#wanted[slot] ?? null
    }
    return work
  }
}

/** Which shadow maps are out of date, and which are drawn next: Rohmer et al. 2014, section 5. */

export interface ShadowWork {
  readonly slot: number
  readonly room: boolean
  readonly virtual: boolean
}

export class ShadowSchedule {
  readonly #room: Uint8Array
  readonly #virtual: Uint8Array
  readonly #fresh: Uint8Array
  #next = 0

  constructor(readonly slots: number) {
    this.#room = new Uint8Array(slots)
    this.#virtual = new Uint8Array(slots)
    this.#fresh = new Uint8Array(slots)
  }

  /** The VAL itself moved: both layers, ahead of the others. */
  valChanged(slot: number): void {
    this.#room[slot] = 1
    this.#virtual[slot] = 1
    this.#fresh[slot] = 1
  }

  /** Objects moved so that the window of the map changed: both layers. */
  fitChanged(slot: number): void {
    this.#room[slot] = 1
    this.#virtual[slot] = 1
  }

  /** Objects moved inside the window. */
  objectsChanged(slot: number): void {
    this.#virtual[slot] = 1
  }

  get pending(): boolean {
    return this.#virtual.includes(1) || this.#room.includes(1)
  }

  /** Takes up to `limit` maps off the list: fresh VALs first, then round robin from where the last call stopped. */
  take(limit: number): ShadowWork[] {
    const work: ShadowWork[] = []
    const takeSlot = (slot: number): void => {
      work.push({ slot, room: this.#room[slot] === 1, virtual: this.#virtual[slot] === 1 })
      this.#room[slot] = 0
      this.#virtual[slot] = 0
      this.#fresh[slot] = 0
    }
    for (let slot = 0; slot < this.slots && work.length < limit; slot++) {
      if (this.#fresh[slot] === 1) {
        takeSlot(slot)
      }
    }
    for (let i = 0; i < this.slots && work.length < limit; i++) {
      const slot = this.#next
      if (this.#room[slot] === 1 || this.#virtual[slot] === 1) {
        takeSlot(slot)
      }
      this.#next = (this.#next + 1) % this.slots
    }
    return work
  }
}

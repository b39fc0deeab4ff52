/** Runs a pass only if something that it declares as input changed since it last ran. */
import type { PassReport } from './types'

export class PassRunner<Key extends string> {
  readonly #revisions = new Map<Key, number>()
  readonly #seen = new Map<string, Map<Key, number>>()
  #reports: PassReport[] = []

  /** Something changed. */
  touch(...keys: Key[]): void {
    for (const key of keys) {
      this.#revisions.set(key, (this.#revisions.get(key) ?? 0) + 1)
    }
  }

  /** Forgets what ran: after a lost context everything is made anew. */
  reset(): void {
    this.#seen.clear()
  }

  beginFrame(): void {
    this.#reports = []
  }

  get reports(): readonly PassReport[] {
    return this.#reports
  }

  /**
   * @param work draws; the outputs count as changed when it ran.
   * @returns whether it ran.
   */
  run(name: string, inputs: readonly Key[], outputs: readonly Key[], work: () => void): boolean {
    const seen = this.#seen.get(name)
    const changed = inputs.filter((key) => seen?.get(key) !== (this.#revisions.get(key) ?? 0))
    if (seen && changed.length === 0) {
      this.#reports.push({ name, ran: false, reason: 'inputs unchanged' })
      return false
    }
    this.#seen.set(name, new Map(inputs.map((key) => [key, this.#revisions.get(key) ?? 0])))
    work()
    this.touch(...outputs)
    const reason = seen ? `changed: ${changed.join(', ')}` : 'first frame'
    this.#reports.push({ name, ran: true, reason })
    return true
  }

  /** Records a pass that found nothing to do by its own bookkeeping. */
  idle(name: string): void {
    this.#reports.push({ name, ran: false, reason: 'inputs unchanged' })
  }

  /** Records a pass that the options leave out; it runs in full when it is wanted again. */
  skip(name: string, reason: string): void {
    this.#seen.delete(name)
    this.#reports.push({ name, ran: false, reason })
  }
}

import { parseServerWork, type ServerWork } from '../state/serverWork'

const STATUS_URL = 'api/status'
const PERIOD_MS = 1000

/** Asks the server what it did, as long as somebody looks. */
export class ServerWorkFeed {
  readonly #read: () => Promise<unknown>
  #work: ServerWork | null = null
  #askedMs = Number.NEGATIVE_INFINITY
  #isAsking = false

  constructor(read: () => Promise<unknown> = readStatus) {
    this.#read = read
  }

  /** The newest answer; null if there was none to the last question. */
  get work(): ServerWork | null {
    return this.#work
  }

  /** Call it while the answer is shown: asks once a second, and never twice at once. */
  look(nowMs: number): void {
    if (this.#isAsking || nowMs - this.#askedMs < PERIOD_MS) {
      return
    }
    this.#isAsking = true
    this.#askedMs = nowMs
    this.#read()
      .then(parseServerWork, () => null)
      .then((work) => {
        this.#work = work
        this.#isAsking = false
      })
  }
}

async function readStatus(): Promise<unknown> {
  const response = await fetch(STATUS_URL, { headers: { Accept: 'application/json' } })
  return response.json()
}

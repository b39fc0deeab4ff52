/** What people change, on its way to the server: newest wins, at a rate that the server bears. */
import { LatestSender } from '../interaction/latestSender'
import type { PoseParts } from '../interaction/pose'
import type { Connection } from './ports'

/** At most 15 control messages per second leave a page. */
const SEND_INTERVAL_MS = 67
/** How long the server's echo of an own message may take. */
const SETTLE_MS = 600

type Key = `light ${number}` | `object ${number}`

export class ControlChannel {
  connection: Connection | null = null
  readonly #sender = new LatestSender<Key, number | PoseParts>(SEND_INTERVAL_MS, (key, value) => {
    const index = Number(key.slice(key.indexOf(' ') + 1))
    if (typeof value === 'number') {
      this.connection?.setLightWeight(index, value)
    } else {
      this.connection?.setObjectPose(index, value.position, value.quaternion)
    }
  })

  setLightWeight(lightIndex: number, weight: number): void {
    this.#sender.offer(`light ${lightIndex}`, weight)
  }

  setObjectPose(objectIndex: number, parts: PoseParts): void {
    this.#sender.offer(`object ${objectIndex}`, parts)
  }

  /** Whether the server's word on a light may be older than ours. */
  isLightUnsettled(lightIndex: number): boolean {
    return this.#sender.isBusy(`light ${lightIndex}`, SETTLE_MS)
  }

  isObjectUnsettled(objectIndex: number): boolean {
    return this.#sender.isBusy(`object ${objectIndex}`, SETTLE_MS)
  }
}

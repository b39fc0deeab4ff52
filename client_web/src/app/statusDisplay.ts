/** Tells people about the connection and the numbers behind the picture. */
import type { Shell } from '../ui/shell'
import { strings } from '../ui/strings'
import type { ConnectionState } from './ports'
import { ServerWorkFeed } from './serverWorkFeed'
import type { Viewer } from './viewer'

const REFRESH_MS = 250

export class StatusDisplay {
  readonly #shell: Shell
  readonly #viewer: Viewer
  readonly #serverWork = new ServerWorkFeed()
  #wasLost = false

  constructor(shell: Shell, viewer: Viewer) {
    this.#shell = shell
    this.#viewer = viewer
    window.setInterval(() => {
      if (!document.hidden) {
        this.refresh()
      }
    }, REFRESH_MS)
  }

  connectionChanged(state: ConnectionState): void {
    const { toasts, overlay } = this.#shell
    if (state.kind === 'waiting' && !this.#wasLost) {
      this.#wasLost = true
      toasts.show('connection', 'warning', strings.messages.lost, 0)
    } else if (state.kind === 'live' && this.#wasLost) {
      this.#wasLost = false
      toasts.show('connection', 'info', strings.messages.back, 3000)
    } else if (state.kind === 'closed') {
      toasts.dismiss('connection')
      const [title, text] = {
        version: [strings.messages.versionTitle, strings.messages.version],
        full: [strings.messages.fullTitle, strings.messages.full],
        other: [strings.messages.closedTitle, state.text],
      }[state.reason] as [string, string]
      overlay.fail(title, text, () => window.location.reload())
    }
    this.refresh()
  }

  messageRefused(_text: string): void {
    this.#shell.toasts.show('refused', 'error', strings.messages.lightRefused, 5000)
  }

  refresh(): void {
    const { feed, connectionState, controls, numbers, report } = this.#viewer
    if (!controls) {
      return
    }
    const now = performance.now()
    const isLive = connectionState.kind === 'live'
    const isStale = isLive && feed.isStale(now)
    const text = isStale ? strings.connection.stale : describeConnection(connectionState)
    const tone = connectionState.kind === 'closed' ? 'bad' : isLive && !isStale ? 'good' : 'waiting'
    const age = feed.ageMs(now)
    controls.setConnection(tone, text, isLive ? age : null)
    if (!controls.isInfoShown) {
      return
    }
    if (isLive) {
      this.#serverWork.look(now)
    }
    controls.setInfo({
      connection: text,
      lightAgeMs: age,
      vals: feed.numVals,
      packetBytes: feed.packetBytes,
      updatesPerSecond: feed.updatesPerSecond(now),
      frameMs: numbers.frameMs,
      width: numbers.width,
      height: numbers.height,
      passes: report.passes,
      work: isLive ? this.#serverWork.work : null,
    })
  }
}

/** Words for the state of a connection. */
function describeConnection(state: ConnectionState): string {
  switch (state.kind) {
    case 'connecting':
      return strings.connection.connecting
    case 'live':
      return strings.connection.live
    case 'waiting':
      return state.retryMs >= 1000
        ? strings.connection.retryIn(Math.round(state.retryMs / 1000))
        : strings.connection.reconnecting
    case 'closed':
      return strings.connection.closed
  }
}

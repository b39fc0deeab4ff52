/** Light, processes and recording of the service. */
import { element, setText } from '../ui/dom'
import { bytes, perSecond } from '../ui/format'
import { chart } from './chart'
import { Fields } from './fields'
import { type History, increments, type Process, type Recording, type Status } from './model'
import { formats, ifKnown, seconds, words } from './words'

export class LightCard {
  readonly element: HTMLElement
  readonly #fields = new Fields()
  readonly #age = chart({ title: words.charts.lightAge, format: seconds, leastTop: 0.1 })
  readonly #updates = chart({ title: words.charts.updates, format: perSecond, leastTop: 1 })
  readonly #clients = chart({ title: words.charts.clients, format: formats.count, leastTop: 1 })

  constructor() {
    this.element = element(
      'article',
      { className: 'card' },
      element('header', {}, element('h3', {}, words.light)),
      this.#fields.element,
      element(
        'div',
        { className: 'charts' },
        this.#age.element,
        this.#updates.element,
        this.#clients.element,
      ),
    )
  }

  show(status: Status): void {
    const { fields } = words
    const age = ifKnown(status.lightAgeS, seconds)
    this.#fields.set(fields.age, age !== null && status.isStale ? `${age} (${words.state.stale})` : age)
    this.#fields.set(fields.packet, ifKnown(status.packetBytes, bytes))
    this.#fields.set(fields.backend, status.backend)
    this.#fields.set(fields.clients, `${status.clients} / ${status.maxClients}`)
    this.#fields.set(fields.uptime, ifKnown(status.uptimeS, seconds))
  }

  showHistory({ agoS, light }: History): void {
    this.#age.set(agoS, light.age_s ?? [])
    this.#updates.set(agoS, increments(light.updates ?? []))
    this.#clients.set(agoS, light.clients ?? [])
  }
}

export class ProcessCard {
  readonly element: HTMLElement
  readonly #list = element('ul', { className: 'work' })

  constructor() {
    this.element = element(
      'article',
      { className: 'card' },
      element('header', {}, element('h3', {}, words.processes)),
      this.#list,
    )
  }

  show(processes: readonly Process[]): void {
    this.#list.replaceChildren(
      ...processes.map((process) =>
        element(
          'li',
          { className: process.isWell ? 'ran' : '' },
          element('span', { className: 'work-name' }, process.name),
          element('span', { className: 'work-state' }, process.phase),
          element(
            'span',
            { className: 'work-reason' },
            [words.restarted(process.restarts), process.words].filter((text) => text !== '').join(': '),
          ),
        ),
      ),
    )
  }
}

export class RecordingCard {
  readonly element: HTMLElement
  readonly #fields = new Fields()
  readonly #warning = element('p', { className: 'words' })

  constructor() {
    this.element = element(
      'article',
      { className: 'card', hidden: true },
      element('header', {}, element('h3', {}, words.recording)),
      this.#warning,
      this.#fields.element,
    )
  }

  show(recording: Recording | null): void {
    this.element.hidden = recording === null
    if (recording === null) {
      return
    }
    setText(this.#warning, recording.warning)
    this.#fields.set('Folder', recording.folder)
    this.#fields.set('Pictures', words.recorded(recording.written, recording.dropped))
    this.#fields.set(
      'Rate',
      ifKnown(recording.megabytesPerS, (rate) => `${rate.toFixed(1)} MB/s`),
    )
    this.#fields.set('Room on the disk', ifKnown(recording.minutesLeft, words.room))
  }
}

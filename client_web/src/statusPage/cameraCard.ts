import { element, setText } from '../ui/dom'
import { share } from '../ui/format'
import { chart } from './chart'
import { Fields } from './fields'
import { type Camera, type History, increments } from './model'
import { Preview } from './preview'
import { celsius, exposures, formats, ifKnown, seconds, words } from './words'

/** Everything about one camera: state in words, picture, numbers, the last minutes. */
export class CameraCard {
  readonly element: HTMLElement
  readonly preview: Preview
  readonly #state = element('span', { className: 'state' })
  readonly #words = element('ul', { className: 'words' })
  readonly #fields = new Fields()
  readonly #rate = chart({ title: words.charts.rate, format: formats.perSecond, leastTop: 1 })
  readonly #lost = chart({ title: words.charts.lost, format: formats.perSecond, leastTop: 1 })
  readonly #saturated = chart({ title: words.charts.saturated, format: share, leastTop: 0.001 })
  readonly #age = chart({ title: words.charts.age, format: seconds, leastTop: 0.1 })
  readonly #temperature = chart({ title: words.charts.temperature, format: celsius, leastTop: 50 })

  constructor(id: string) {
    this.preview = new Preview(id)
    this.element = element(
      'article',
      { className: 'card camera' },
      element('header', {}, element('h3', {}, id), this.#state),
      this.#words,
      this.preview.element,
      this.#fields.element,
      element(
        'div',
        { className: 'charts' },
        this.#rate.element,
        this.#lost.element,
        this.#saturated.element,
        this.#age.element,
        this.#temperature.element,
      ),
    )
  }

  show(camera: Camera): void {
    setText(this.#state, words.state[camera.state])
    this.#state.dataset.state = camera.state
    this.#showWords([camera.fault, ...camera.warnings].filter((text) => text !== ''))
    const { fields } = words
    const set = (label: string, value: string | null): void => this.#fields.set(label, value)
    set(fields.device, [camera.kind, camera.model].filter(Boolean).join(' · ') || null)
    set(fields.exposure, exposures(camera))
    set(fields.frames, ifKnown(camera.frames, formats.count))
    set(fields.lost, ifKnown(camera.framesLost, formats.count))
    set(fields.broken, ifKnown(camera.framesBroken, formats.count))
    set(fields.saturated, ifKnown(camera.saturatedShare, share))
    set(fields.age, ifKnown(camera.ageS, seconds))
    set(fields.temperature, ifKnown(camera.temperatureC, celsius))
    set(fields.reconnects, ifKnown(camera.reconnects || null, formats.count))
    set(fields.restarts, ifKnown(camera.restarts || null, formats.count))
  }

  showHistory(history: History, id: string): void {
    const { agoS } = history
    const series = history.cameras[id] ?? {}
    const of = (name: string): readonly (number | null)[] => series[name] ?? []
    const lost = increments(of('frames_lost'))
    const broken = increments(of('frames_broken'))
    this.#rate.set(agoS, of('frame_rate'))
    this.#lost.set(
      agoS,
      lost.map((count, index) => sum(count, broken[index] ?? null)),
    )
    this.#saturated.set(agoS, of('saturated_share'))
    this.#age.set(agoS, of('age_s'))
    this.#temperature.set(agoS, of('temperature_c'))
  }

  #showWords(lines: readonly string[]): void {
    while (this.#words.children.length > lines.length) {
      this.#words.lastElementChild?.remove()
    }
    lines.forEach((line, index) => {
      const item = this.#words.children[index] ?? this.#words.appendChild(element('li'))
      setText(item as HTMLElement, line)
    })
  }
}

function sum(first: number | null, second: number | null): number | null {
  return first === null && second === null ? null : (first ?? 0) + (second ?? 0)
}

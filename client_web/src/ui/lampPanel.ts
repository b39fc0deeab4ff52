import type { LightDescription } from '../state/sceneDescription'
import { type Slider, slider, switchInput } from './controls'
import { element } from './dom'
import { lampColour, readableName } from './format'
import { strings } from './strings'

export interface LampPanel {
  readonly element: HTMLElement
  setWeight(lightIndex: number, weight: number): void
}

/** One row per lamp: colour, name, dimmer, on/off. */
export function lampPanel(
  lights: readonly LightDescription[],
  onWeight: (lightIndex: number, weight: number) => void,
): LampPanel {
  const rows = lights.map((light) => new LampRow(light, (weight) => onWeight(light.index, weight)))
  const children =
    rows.length > 0
      ? rows.map((row) => row.element)
      : [element('p', { className: 'hint' }, strings.lamps.none)]
  return {
    element: element('div', { className: 'panel' }, ...children),
    setWeight: (lightIndex, weight) => rows[lightIndex]?.set(weight),
  }
}

class LampRow {
  readonly element: HTMLElement
  readonly #dimmer: Slider
  readonly #power: HTMLInputElement
  readonly #dot: HTMLElement
  /** Where the dimmer returns to when the lamp is switched on. */
  #lastWeight: number

  constructor(light: LightDescription, onWeight: (weight: number) => void) {
    const name = readableName(light.name)
    this.#lastWeight = light.weight > 0 ? light.weight : 1
    this.#dot = element('span', { className: 'dot' })
    this.#dot.style.backgroundColor = lampColour(light.radiance)
    const most = Math.round(100 * Math.max(1, light.weight))
    this.#dimmer = slider(
      strings.lamps.dimmer(name),
      { min: 0, max: most, step: 1 },
      (percent) => strings.lamps.percent(Math.round(percent)),
      (percent) => {
        this.#note(percent / 100)
        onWeight(percent / 100)
      },
    )
    this.#power = switchInput(light.weight > 0, (on) => {
      const weight = on ? this.#lastWeight : 0
      this.set(weight)
      onWeight(weight)
    })
    this.#power.setAttribute('aria-label', strings.lamps.power(name))
    this.element = element(
      'div',
      { className: 'lamp', attributes: { role: 'group', 'aria-label': name } },
      element(
        'div',
        { className: 'row' },
        this.#dot,
        element('span', { className: 'row-label' }, name),
        this.#power,
      ),
      this.#dimmer.element,
    )
    this.set(light.weight)
  }

  set(weight: number): void {
    // A slider under a finger is the newest truth; the echo of an earlier value must not pull it back.
    if (!this.#dimmer.input.matches(':active')) {
      this.#dimmer.set(Math.round(100 * weight))
    }
    this.#note(weight)
  }

  #note(weight: number): void {
    if (weight > 0) {
      this.#lastWeight = weight
    }
    this.#power.checked = weight > 0
    this.#dot.style.opacity = String(0.2 + 0.8 * Math.min(1, weight))
  }
}

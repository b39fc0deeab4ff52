/** The few controls that the panels are made of. All are at least 44 CSS pixels high and work by keyboard. */
import { element, setText, uniqueId } from './dom'
import { type IconName, icon } from './icons'

export function button(label: string, iconName: IconName | null, onPress: () => void): HTMLButtonElement {
  const node = element('button', { type: 'button', className: 'button' })
  if (iconName) {
    node.append(icon(iconName))
  }
  node.append(element('span', {}, label))
  node.addEventListener('click', onPress)
  return node
}

export function iconButton(label: string, iconName: IconName, onPress: () => void): HTMLButtonElement {
  const node = element(
    'button',
    { type: 'button', className: 'icon-button', attributes: { 'aria-label': label } },
    icon(iconName),
  )
  node.addEventListener('click', onPress)
  return node
}

export interface Switch {
  readonly element: HTMLElement
  set(on: boolean): void
}

/** A labelled on/off switch. */
export function switchRow(label: string, on: boolean, onChange: (on: boolean) => void): Switch {
  const input = switchInput(on, onChange)
  input.id = uniqueId('switch')
  const row = element(
    'label',
    { className: 'row', htmlFor: input.id },
    element('span', { className: 'row-label' }, label),
    input,
  )
  return {
    element: row,
    set: (value) => {
      input.checked = value
    },
  }
}

export function switchInput(on: boolean, onChange: (on: boolean) => void): HTMLInputElement {
  const input = element('input', {
    type: 'checkbox',
    className: 'switch',
    checked: on,
    attributes: { role: 'switch' },
  })
  input.addEventListener('change', () => onChange(input.checked))
  return input
}

export interface Slider {
  readonly element: HTMLElement
  readonly input: HTMLInputElement
  set(value: number): void
}

/** A slider with its value written beside it. */
export function slider(
  label: string,
  range: { min: number; max: number; step: number },
  format: (value: number) => string,
  onInput: (value: number) => void,
): Slider {
  const input = element('input', {
    type: 'range',
    className: 'slider',
    min: String(range.min),
    max: String(range.max),
    step: String(range.step),
    attributes: { 'aria-label': label },
  })
  const output = element('output', { className: 'value' })
  const show = (value: number): void => {
    const share = (value - range.min) / (range.max - range.min)
    input.style.setProperty('--share', `${100 * Math.min(1, Math.max(0, share))}%`)
    input.setAttribute('aria-valuetext', format(value))
    setText(output, format(value))
  }
  input.addEventListener('input', () => {
    show(input.valueAsNumber)
    onInput(input.valueAsNumber)
  })
  return {
    element: element('div', { className: 'slider-row' }, input, output),
    input,
    set: (value) => {
      input.value = String(value)
      show(value)
    },
  }
}

export interface Choice {
  readonly long: string
  readonly short: string
  /** For narrow screens. */
  readonly tiny: string
}

export interface Segmented {
  readonly element: HTMLElement
  set(index: number): void
}

/** One of a few choices, side by side. Native radio buttons bring the arrow keys. */
export function segmented(
  label: string,
  choices: readonly Choice[],
  onChoose: (index: number) => void,
): Segmented {
  const name = uniqueId('choice')
  const inputs = choices.map((choice, index) => {
    const input = element('input', {
      type: 'radio',
      name,
      className: 'visually-hidden',
      attributes: { 'aria-label': choice.long },
    })
    input.addEventListener('change', () => onChoose(index))
    return input
  })
  const labels = choices.map((choice, index) =>
    element(
      'label',
      { className: 'segment' },
      inputs[index] as HTMLInputElement,
      element(
        'span',
        { className: 'segment-text' },
        element('span', { className: 'if-wide' }, choice.short),
        element('span', { className: 'if-narrow' }, choice.tiny),
      ),
    ),
  )
  return {
    element: element(
      'div',
      { className: 'segmented', attributes: { role: 'radiogroup', 'aria-label': label } },
      ...labels,
    ),
    set: (index) => {
      inputs.forEach((input, position) => {
        input.checked = position === index
      })
    },
  }
}

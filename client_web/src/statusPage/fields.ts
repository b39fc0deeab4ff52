import { element, setText } from '../ui/dom'

/** A list of named values; those that are not known are left out. */
export class Fields {
  readonly element = element('dl', { className: 'numbers' })
  readonly #values = new Map<string, { label: HTMLElement; value: HTMLElement }>()

  set(label: string, text: string | null): void {
    let row = this.#values.get(label)
    if (row === undefined) {
      row = { label: element('dt', {}, label), value: element('dd', {}) }
      this.#values.set(label, row)
      this.element.append(row.label, row.value)
    }
    row.label.hidden = text === null
    row.value.hidden = text === null
    setText(row.value, text ?? '')
  }
}

/** Rows of the set-up forms. */
import { element, uniqueId } from '../ui/dom'

export const NAME_PATTERN = '[A-Za-z0-9][A-Za-z0-9_.\\-]{0,63}'

/** A label beside its control. */
export function field(label: string, control: HTMLElement): HTMLElement {
  const input = control.matches('input, select') ? control : control.querySelector('input, select')
  if (input !== null && input.id === '') {
    input.id = uniqueId('field')
  }
  return element(
    'div',
    { className: 'field' },
    element('label', { className: 'caption-label', htmlFor: input?.id ?? '' }, label),
    control,
  )
}

export function textInput(value: string, pattern: string | null): HTMLInputElement {
  const input = element('input', {
    type: 'text',
    className: 'text-input',
    value,
    maxLength: 64,
    autocomplete: 'off',
    spellcheck: false,
  })
  if (pattern !== null) {
    input.pattern = pattern
    input.required = true
  }
  return input
}

export function choice(options: readonly string[], chosen: string | null): HTMLSelectElement {
  const select = element(
    'select',
    { className: 'text-input' },
    ...options.map((text) => element('option', { value: text }, text)),
  )
  if (chosen !== null) {
    select.value = chosen
  }
  return select
}

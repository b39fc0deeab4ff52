import { button, iconButton } from './controls'
import { element, setText } from './dom'
import { strings } from './strings'

export type ToastKind = 'info' | 'warning' | 'error'

/** Short messages above the picture. A message with a key replaces the former one with that key. */
export class Toasts {
  readonly element = element('div', {
    className: 'toasts',
    attributes: { role: 'status', 'aria-live': 'polite' },
  })
  readonly #byKey = new Map<string, HTMLElement>()

  /** @param durationMs how long it stays; 0 = until it is dismissed or replaced. */
  show(key: string, kind: ToastKind, text: string, durationMs: number): void {
    this.dismiss(key)
    const toast = element(
      'div',
      { className: `toast toast-${kind}` },
      element('span', { className: 'row-label' }, text),
      iconButton(strings.messages.dismiss, 'close', () => this.dismiss(key)),
    )
    this.#byKey.set(key, toast)
    this.element.append(toast)
    if (durationMs > 0) {
      window.setTimeout(() => {
        if (this.#byKey.get(key) === toast) {
          this.dismiss(key)
        }
      }, durationMs)
    }
  }

  dismiss(key: string): void {
    this.#byKey.get(key)?.remove()
    this.#byKey.delete(key)
  }
}

/** Covers the picture while it loads, or when it cannot go on. */
export class Overlay {
  readonly element: HTMLElement
  readonly #title = element('h1', { className: 'overlay-title' })
  readonly #text = element('p', { className: 'overlay-text' })
  readonly #bar = element('progress', { max: 1, className: 'progress' })
  readonly #actions = element('div', { className: 'overlay-actions' })

  constructor() {
    this.element = element(
      'div',
      { className: 'overlay', hidden: true, attributes: { role: 'alert' } },
      element('div', { className: 'card' }, this.#title, this.#text, this.#bar, this.#actions),
    )
  }

  /** @param share 0 to 1, or null while the amount is unknown. */
  progress(title: string, share: number | null): void {
    setText(this.#title, title)
    this.#text.hidden = true
    this.#actions.replaceChildren()
    this.#bar.hidden = false
    this.#bar.setAttribute('aria-label', title)
    if (share === null) {
      this.#bar.removeAttribute('value')
    } else {
      this.#bar.value = share
    }
    this.element.hidden = false
  }

  fail(title: string, text: string, onReload: (() => void) | null): void {
    setText(this.#title, title)
    setText(this.#text, text)
    this.#text.hidden = false
    this.#bar.hidden = true
    this.#actions.replaceChildren(
      ...(onReload ? [button(strings.messages.reload, 'turnRight', onReload)] : []),
    )
    this.element.hidden = false
  }

  hide(): void {
    this.element.hidden = true
  }
}

import { iconButton } from './controls'
import { element, uniqueId } from './dom'
import { type IconName, icon } from './icons'
import { strings } from './strings'

export interface SheetPage {
  readonly label: string
  readonly icon: IconName
  readonly content: HTMLElement
}

/** Tabs beside the picture (wide screens) or below it (upright screens); can be folded away. */
export class Sheet {
  readonly element: HTMLElement
  readonly #tabs: HTMLButtonElement[]
  readonly #panels: HTMLElement[]
  readonly #fold: HTMLButtonElement
  readonly #onResize: () => void
  #open = true

  constructor(pages: readonly SheetPage[], onResize: () => void) {
    this.#onResize = onResize
    this.#panels = pages.map((page) =>
      element(
        'div',
        { className: 'sheet-page', id: uniqueId('page'), attributes: { role: 'tabpanel' } },
        page.content,
      ),
    )
    this.#tabs = pages.map((page, index) => this.#tab(page, index))
    this.#fold = iconButton(strings.sheet.collapse, 'chevron', () => this.setOpen(!this.#open))
    this.#fold.classList.add('fold')
    this.element = element(
      'section',
      { className: 'sheet', attributes: { 'aria-label': strings.sheet.title } },
      element(
        'div',
        { className: 'sheet-bar' },
        element('div', { className: 'tabs', attributes: { role: 'tablist' } }, ...this.#tabs),
        this.#fold,
      ),
      element('div', { className: 'sheet-pages' }, ...this.#panels),
    )
    this.show(0)
  }

  get open(): boolean {
    return this.#open
  }

  /** Whether people can see this page. */
  isShowing(index: number): boolean {
    return this.#open && this.#panels[index]?.hidden === false
  }

  setOpen(open: boolean): void {
    this.#open = open
    this.element.classList.toggle('folded', !open)
    this.#fold.setAttribute('aria-label', open ? strings.sheet.collapse : strings.sheet.expand)
    this.#fold.setAttribute('aria-expanded', String(open))
    this.#onResize()
  }

  show(index: number): void {
    this.#tabs.forEach((tab, position) => {
      tab.setAttribute('aria-selected', String(position === index))
      tab.tabIndex = position === index ? 0 : -1
    })
    this.#panels.forEach((panel, position) => {
      panel.hidden = position !== index
    })
  }

  #tab(page: SheetPage, index: number): HTMLButtonElement {
    const panel = this.#panels[index] as HTMLElement
    const tab = element(
      'button',
      {
        type: 'button',
        className: 'tab',
        id: uniqueId('tab'),
        attributes: { role: 'tab', 'aria-controls': panel.id },
      },
      icon(page.icon),
      element('span', {}, page.label),
    )
    panel.setAttribute('aria-labelledby', tab.id)
    tab.addEventListener('click', () => {
      this.show(index)
      if (!this.#open) {
        this.setOpen(true)
      }
    })
    tab.addEventListener('keydown', (event) => {
      const step = event.key === 'ArrowRight' ? 1 : event.key === 'ArrowLeft' ? -1 : 0
      if (step !== 0) {
        const next = (index + step + this.#tabs.length) % this.#tabs.length
        this.show(next)
        this.#tabs[next]?.focus()
      }
    })
    return tab
  }
}

/** What a device did for the last picture or update, what it left out, and why: one line each, folded to a summary. */
import { element, setText } from './dom'
import { duration, share } from './format'
import { strings } from './strings'

const NOW_MS = 1000

export interface WorkItem {
  readonly name: string
  readonly ran: boolean
  /** Share of the whole work that was done, 0 to 1. */
  readonly part: number
  readonly reason: string
}

export interface WorkSection {
  readonly element: HTMLElement
  /** @param ageMs time since it was done; null = just now. */
  set(items: readonly WorkItem[], ageMs: number | null): void
}

export function workSection(title: string): WorkSection {
  const summary = element('span', { className: 'value' })
  const list = element('ul', { className: 'work' })
  const details = element(
    'details',
    { className: 'details', open: true },
    element('summary', {}, element('span', { className: 'row-label' }, title), summary),
    list,
  )
  return {
    element: details,
    set: (items, ageMs) => {
      setText(summary, items.length === 0 ? strings.info.unknown : summaryOf(items, ageMs))
      showItems(list, items)
    },
  }
}

function summaryOf(items: readonly WorkItem[], ageMs: number | null): string {
  const ran = items.filter((item) => item.ran).length
  const text = `${strings.work.ranCount(ran)}, ${strings.work.skippedCount(items.length - ran)}`
  return ageMs === null || ageMs < NOW_MS ? text : strings.work.ago(duration(ageMs), text)
}

function showItems(list: HTMLElement, items: readonly WorkItem[]): void {
  while (list.children.length > items.length) {
    list.lastElementChild?.remove()
  }
  items.forEach((item, index) => {
    const row =
      (list.children[index] as HTMLElement | undefined) ??
      list.appendChild(
        element(
          'li',
          {},
          element('span', { className: 'work-name' }),
          element('span', { className: 'work-state' }),
          element('span', { className: 'work-reason' }),
        ),
      )
    row.classList.toggle('ran', item.ran)
    setText(row.children[0] as HTMLElement, item.name)
    setText(row.children[1] as HTMLElement, stateOf(item))
    setText(row.children[2] as HTMLElement, item.reason)
  })
}

function stateOf(item: WorkItem): string {
  if (!item.ran) {
    return strings.work.skipped
  }
  return item.part < 1 ? strings.work.ranInPart(share(item.part)) : strings.work.ran
}

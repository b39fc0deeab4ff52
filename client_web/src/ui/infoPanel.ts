import { element, setText } from './dom'
import { bytes, milliseconds, perSecond } from './format'
import { strings } from './strings'

export interface PassReport {
  readonly name: string
  readonly ran: boolean
  readonly reason: string
}

/** Numbers about the light and the picture. */
export interface InfoNumbers {
  readonly connection: string
  readonly lightAgeMs: number | null
  readonly vals: number
  readonly packetBytes: number
  readonly updatesPerSecond: number
  readonly frameMs: number | null
  readonly width: number
  readonly height: number
  readonly passes: readonly PassReport[]
}

export interface InfoPanel {
  readonly element: HTMLElement
  set(numbers: InfoNumbers): void
}

export function infoPanel(): InfoPanel {
  const list = element('dl', { className: 'numbers' })
  const field = (label: string): HTMLElement => {
    const value = element('dd', {}, strings.info.unknown)
    list.append(element('dt', {}, label), value)
    return value
  }
  const connection = field(strings.info.connection)
  const age = field(strings.info.age)
  const vals = field(strings.info.vals)
  const size = field(strings.info.bytes)
  const rate = field(strings.info.rate)
  const frame = field(strings.info.frame)
  const scale = field(strings.info.scale)
  const summary = element('span', { className: 'value' })
  const passes = element('ul', { className: 'passes' })
  const details = element(
    'details',
    { className: 'details' },
    element('summary', {}, element('span', { className: 'row-label' }, strings.info.passes), summary),
    passes,
  )
  return {
    element: element('div', { className: 'panel' }, list, details),
    set: (numbers) => {
      setText(connection, numbers.connection)
      setText(age, milliseconds(numbers.lightAgeMs))
      setText(vals, String(numbers.vals))
      setText(size, numbers.packetBytes > 0 ? bytes(numbers.packetBytes) : strings.info.unknown)
      setText(rate, numbers.updatesPerSecond > 0 ? perSecond(numbers.updatesPerSecond) : strings.info.unknown)
      setText(frame, milliseconds(numbers.frameMs))
      setText(scale, `${numbers.width} × ${numbers.height}`)
      const ran = numbers.passes.filter((pass) => pass.ran).length
      setText(summary, `${strings.info.ran(ran)}, ${strings.info.skipped(numbers.passes.length - ran)}`)
      showPasses(passes, numbers.passes)
    },
  }
}

function showPasses(list: HTMLElement, passes: readonly PassReport[]): void {
  while (list.children.length > passes.length) {
    list.lastElementChild?.remove()
  }
  passes.forEach((pass, index) => {
    const item =
      (list.children[index] as HTMLElement | undefined) ??
      list.appendChild(element('li', {}, element('span'), element('span', { className: 'value' })))
    item.classList.toggle('ran', pass.ran)
    setText(item.children[0] as HTMLElement, pass.name)
    setText(item.children[1] as HTMLElement, pass.reason)
  })
}

/** A small chart of one quantity over the last minutes, as SVG: it stays sharp at any size and costs nothing while it stands still. */
import { element, setText } from '../ui/dom'

const NAMESPACE = 'http://www.w3.org/2000/svg'
const WIDTH = 240
const HEIGHT = 48
/** Time that charts show, s. */
export const SPAN_S = 300

export interface ChartOptions {
  readonly title: string
  /** As people read a value. */
  readonly format: (value: number) => string
  /** Least upper end of the scale, so that noise around 0 is not drawn as mountains. */
  readonly leastTop: number
}

/** Not shown as long as nothing is known. */
export interface Chart {
  readonly element: HTMLElement
  set(agoS: readonly number[], values: readonly (number | null)[]): void
}

/** A line, broken where values are unknown. Every path starts with M. */
export function linePath(agoS: readonly number[], values: readonly (number | null)[], top: number): string {
  let path = ''
  let isDrawing = false
  values.forEach((value, index) => {
    const ago = agoS[index]
    if (value === null || ago === undefined || ago > SPAN_S) {
      isDrawing = false
      return
    }
    const x = WIDTH * (1 - Math.max(0, ago) / SPAN_S)
    const y = HEIGHT * (1 - Math.min(1, Math.max(0, value / top)))
    path += `${isDrawing ? 'L' : 'M'}${x.toFixed(1)} ${y.toFixed(1)}`
    isDrawing = true
  })
  return path
}

/** The scale ends at 1, 2 or 5 times a power of ten, so that it does not change with every sample. */
export function scaleTop(values: readonly (number | null)[], leastTop: number): number {
  const largest = values.reduce<number>((most, value) => Math.max(most, value ?? 0), leastTop)
  const power = 10 ** Math.floor(Math.log10(largest))
  const step = [1, 2, 5, 10].find((factor) => factor * power >= largest * (1 - 1e-9)) ?? 10
  return step * power
}

export function chart(options: ChartOptions): Chart {
  const now = element('span', { className: 'value' })
  const top = element('span', { className: 'chart-top' })
  const svg = document.createElementNS(NAMESPACE, 'svg')
  svg.setAttribute('viewBox', `0 0 ${WIDTH} ${HEIGHT}`)
  svg.setAttribute('preserveAspectRatio', 'none')
  svg.setAttribute('role', 'img')
  const path = document.createElementNS(NAMESPACE, 'path')
  svg.append(path)
  const figure = element(
    'figure',
    { className: 'chart', hidden: true },
    element('figcaption', {}, element('span', { className: 'row-label' }, options.title), now),
    element('div', { className: 'chart-area' }, svg, top),
  )
  return {
    element: figure,
    set: (agoS, values) => {
      figure.hidden = values.every((value) => value === null)
      const last = values.at(-1) ?? null
      const scale = scaleTop(values, options.leastTop)
      const text = last === null ? '–' : options.format(last)
      setText(now, text)
      setText(top, options.format(scale))
      path.setAttribute('d', linePath(agoS, values, scale))
      svg.setAttribute('aria-label', `${options.title}: ${text}, scale to ${options.format(scale)}`)
    },
  }
}

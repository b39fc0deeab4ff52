/** How the pixels of a picture are spread between black and the full signal. */
import { element, setText } from '../ui/dom'
import { share } from '../ui/format'
import { words } from './words'

const NAMESPACE = 'http://www.w3.org/2000/svg'
const WIDTH = 256
const HEIGHT = 56

/** Outline of the bins as an SVG path; heights are square roots of the shares, relative to the largest. */
export function histogramPath(shares: readonly number[], width: number, height: number): string {
  const most = Math.max(...shares)
  let path = `M0 ${height}`
  shares.forEach((value, index) => {
    const top = most > 0 ? height * (1 - Math.sqrt(value / most)) : height
    path += `V${round(top)}H${round((width * (index + 1)) / shares.length)}`
  })
  return `${path}L${width} ${height}Z`
}

function round(value: number): number {
  return Math.round(10 * value) / 10
}

export class Histogram {
  readonly element: HTMLElement
  readonly #svg = document.createElementNS(NAMESPACE, 'svg')
  readonly #shares = document.createElementNS(NAMESPACE, 'path')
  readonly #clipped = document.createElementNS(NAMESPACE, 'rect')
  readonly #value = element('span', { className: 'value' })
  readonly #line: HTMLElement

  constructor() {
    this.#svg.setAttribute('viewBox', `0 0 ${WIDTH} ${HEIGHT}`)
    this.#svg.setAttribute('preserveAspectRatio', 'none')
    this.#svg.setAttribute('class', 'histogram')
    this.#svg.setAttribute('role', 'img')
    this.#shares.setAttribute('class', 'shares')
    this.#clipped.setAttribute('class', 'clipped')
    this.#clipped.setAttribute('x', String(WIDTH - 4))
    this.#clipped.setAttribute('width', '4')
    this.#svg.append(this.#shares, this.#clipped)
    this.#line = element('div', { className: 'saturated' }, element('span', {}, words.saturated), this.#value)
    this.element = element('div', {}, this.#line)
    this.element.prepend(this.#svg)
  }

  show(shares: readonly number[], saturatedShare: number): void {
    this.#shares.setAttribute('d', histogramPath(shares, WIDTH, HEIGHT))
    const height = HEIGHT * Math.sqrt(Math.min(1, saturatedShare))
    this.#clipped.setAttribute('y', String(HEIGHT - height))
    this.#clipped.setAttribute('height', String(height))
    setText(this.#value, share(saturatedShare))
    this.#line.dataset.tone = saturatedShare > 0.02 ? 'bad' : 'good'
    this.#svg.setAttribute('aria-label', words.histogram(share(saturatedShare)))
  }
}

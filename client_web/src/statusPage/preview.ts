/** The picture of a camera, renewed while it can be seen: a camera renders it only when somebody asks. */
import { element, setText } from '../ui/dom'
import { words } from './words'

const PERIOD_MS = 2000

export class Preview {
  readonly element: HTMLElement
  readonly #image: HTMLImageElement
  readonly #note = element('span', { className: 'preview-note' }, words.noPreview)
  readonly #url: string
  #isVisible = false
  #isLoading = false
  #askedMs = Number.NEGATIVE_INFINITY

  constructor(cameraId: string) {
    this.#url = `api/cameras/${encodeURIComponent(cameraId)}/preview.jpg`
    this.#image = element('img', {
      alt: words.previewOf(cameraId),
      title: words.previewOf(cameraId),
      hidden: true,
    })
    this.element = element('div', { className: 'preview' }, this.#image, this.#note)
    new IntersectionObserver((entries) => {
      this.#isVisible = entries.at(-1)?.isIntersecting ?? false
    }).observe(this.element)
    this.#image.addEventListener('load', () => this.#loaded(true))
    this.#image.addEventListener('error', () => this.#loaded(false))
  }

  /** Call it often: asks for a new picture when it is time, and never twice at once. */
  look(nowMs: number): void {
    if (!this.#isVisible || document.hidden || this.#isLoading || nowMs - this.#askedMs < PERIOD_MS) {
      return
    }
    this.#isLoading = true
    this.#askedMs = nowMs
    this.#image.src = `${this.#url}?at=${Math.round(nowMs)}`
  }

  #loaded(isThere: boolean): void {
    this.#isLoading = false
    this.#image.hidden = !isThere
    this.#note.hidden = isThere
    setText(this.#note, words.noPreview)
  }
}

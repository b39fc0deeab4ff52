/** One connected camera: its picture about once a second, its exposure, and whether it shall be in the room. */
import { button, slider, switchRow } from '../ui/controls'
import { element, setText } from '../ui/dom'
import { exposureTime } from '../ui/format'
import { choice, field, NAME_PATTERN, textInput } from './form'
import { Histogram } from './histogram'
import {
  type Answer,
  type Camera,
  type ChosenCamera,
  canLook,
  findExposure,
  type Look,
  mayJoin,
  readLook,
} from './model'
import { words } from './words'

const PERIOD_MS = 1000
const RETRY_MS = 4000
const NAMESPACE = 'http://www.w3.org/2000/svg'

export class CameraCard {
  readonly element: HTMLElement
  readonly #camera: Camera
  readonly #image = element('img', { hidden: true })
  readonly #note = element('span', { className: 'preview-note' }, words.noPicture)
  readonly #circle = document.createElementNS(NAMESPACE, 'svg')
  readonly #histogram = new Histogram()
  readonly #name: HTMLInputElement
  readonly #format: HTMLSelectElement
  readonly #exposure
  readonly #find = button(words.find, null, () => {
    this.#isFinding = true
    this.#hurry()
  })
  readonly #field
  #fieldDegrees = 180
  #isIncluded: boolean
  #exposureS: number | null = null
  /** The exposure of the last picture, s; null where it cannot be set. */
  #shownS: number | null = null
  #isVisible = false
  #isLooking = false
  /** The next picture is taken with the exposure that suits. */
  #isFinding = false
  #nextMs = 0

  constructor(camera: Camera, name: string) {
    this.#camera = camera
    this.#isIncluded = mayJoin(camera)
    this.#name = textInput(name, NAME_PATTERN)
    this.#format = choice(camera.pixel_formats, camera.pixel_format)
    this.#format.addEventListener('change', () => this.#hurry())
    this.#image.alt = words.pictureOf(camera.name)
    this.#circle.setAttribute('class', 'circle')
    this.#circle.setAttribute('aria-hidden', 'true')
    // In powers of two: a step is the same change of brightness everywhere.
    this.#exposure = slider(
      words.exposure,
      { min: -20, max: 4, step: 0.125 },
      (stops) => exposureTime(2 ** stops),
      (stops) => {
        this.#exposureS = 2 ** stops
        this.#hurry()
      },
    )
    this.#field = slider(words.field, { min: 90, max: 230, step: 1 }, words.degrees, (degrees) => {
      this.#fieldDegrees = degrees
    })
    this.#field.set(this.#fieldDegrees)
    this.#exposure.input.disabled = true
    this.element = element(
      'article',
      { className: 'card camera' },
      element(
        'header',
        {},
        element('h3', {}, camera.name),
        element('span', { className: 'state', attributes: { 'data-state': this.#tone } }, this.#stateWords),
      ),
      element(
        'p',
        { className: 'where' },
        [camera.kind, camera.place, camera.serial === camera.place ? '' : camera.serial]
          .filter(Boolean)
          .join(' · '),
      ),
      ...(camera.advice === '' ? [] : [element('p', { className: 'words' }, camera.advice)]),
    )
    if (canLook(camera)) {
      this.element.append(this.#body())
    }
    this.#showInclusion()
    new IntersectionObserver((entries) => {
      this.#isVisible = entries.at(-1)?.isIntersecting ?? false
    }).observe(this.element)
  }

  /** What the room file shall say of it; null where it is left out. */
  get choice(): ChosenCamera | null {
    if (!this.#isIncluded) {
      return null
    }
    return {
      index: this.#camera.index,
      id: this.#name.value,
      pixel_format: this.#format.value,
      // What was asked for may not have come back as a picture yet.
      exposure_s: this.#shownS === null ? null : (this.#exposureS ?? this.#shownS),
      field_degrees: this.#fieldDegrees,
    }
  }

  get hasGoodName(): boolean {
    return this.#name.checkValidity()
  }

  /** Call it often: takes a new picture when it is time, and never two at once. */
  look(nowMs: number): void {
    if (
      !canLook(this.#camera) ||
      !this.#isVisible ||
      document.hidden ||
      this.#isLooking ||
      nowMs < this.#nextMs
    ) {
      return
    }
    this.#nextMs = nowMs + PERIOD_MS
    if (this.#isFinding) {
      this.#take(findExposure(this.#camera.index, this.#format.value))
    } else {
      this.#take(readLook(this.#camera.index, this.#format.value, this.#exposureS))
    }
  }

  async #take(asked: Promise<Answer<Look>>): Promise<void> {
    this.#isLooking = true
    const isFinding = this.#isFinding
    const askedS = this.#exposureS
    this.#isFinding = false
    const answer = await asked
    this.#isLooking = false
    if ('value' in answer) {
      if (isFinding) {
        this.#exposureS = answer.value.exposure_s
      }
      this.#show(answer.value, isFinding || this.#exposureS === askedS)
      return
    }
    this.#nextMs = performance.now() + RETRY_MS
    this.#image.hidden = true
    this.#note.hidden = false
    setText(this.#note, answer.error)
    this.#circle.replaceChildren()
  }

  get #tone(): string {
    return canLook(this.#camera) || this.#camera.is_in_room ? 'live' : 'stale'
  }

  get #stateWords(): string {
    return this.#camera.is_in_room ? words.inRoom : this.#camera.state
  }

  #body(): HTMLElement {
    const body = element(
      'div',
      {},
      element('div', { className: 'preview' }, this.#image, this.#circle, this.#note),
      element('div', { className: 'look' }, this.#histogram.element),
    )
    if (mayJoin(this.#camera)) {
      const include = switchRow(words.include, this.#isIncluded, (on) => {
        this.#isIncluded = on
        this.#showInclusion()
      })
      body.append(
        field(words.exposure, this.#exposure.element),
        element('div', { className: 'field' }, element('span'), this.#find),
        field(words.pixelFormat, this.#format),
        field(words.field, this.#field.element),
        include.element,
        field(words.name, this.#name),
      )
    }
    return body
  }

  #showInclusion(): void {
    this.element.classList.toggle('left-out', mayJoin(this.#camera) && !this.#isIncluded)
    this.#name.disabled = !this.#isIncluded
  }

  #hurry(): void {
    this.#nextMs = 0
    this.look(performance.now())
  }

  /** `isNewest`: nobody has asked for another exposure meanwhile. */
  #show(look: Look, isNewest: boolean): void {
    this.#image.src = look.picture
    this.#image.hidden = false
    this.#note.hidden = true
    const [shortest, longest] = look.exposure_range_s
    this.#shownS = shortest < longest ? look.exposure_s : null
    this.#histogram.show(look.histogram, look.saturated_share)
    this.#showExposure(look, isNewest)
    this.#circle.setAttribute('viewBox', `0 0 ${look.width} ${look.height}`)
    this.#circle.replaceChildren()
    if (look.circle !== null) {
      const ring = document.createElementNS(NAMESPACE, 'circle')
      // SVG counts from the corner of the first pixel, not from its centre.
      ring.setAttribute('cx', String(look.circle.x + 0.5))
      ring.setAttribute('cy', String(look.circle.y + 0.5))
      ring.setAttribute('r', String(look.circle.radius))
      this.#circle.append(ring)
    }
  }

  #showExposure(look: Look, isNewest: boolean): void {
    const { input } = this.#exposure
    const [shortest, longest] = look.exposure_range_s
    input.disabled = shortest >= longest
    this.#find.hidden = input.disabled
    if (!input.disabled) {
      input.min = String(Math.max(-20, Math.floor(8 * Math.log2(shortest)) / 8))
      input.max = String(Math.min(4, Math.ceil(8 * Math.log2(longest)) / 8))
    }
    // A finger on the slider is not pushed away.
    if (isNewest && !input.matches(':active')) {
      this.#exposure.set(Math.log2(look.exposure_s))
    }
  }
}

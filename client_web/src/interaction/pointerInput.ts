/**
 * Fingers and mouse on the picture. What touches an object moves it; everything else is left to the orbit camera,
 * which listens on the same element later.
 */
import type { Vector3 } from 'three'
import { angleDifference, twistAngle } from './objectMover'

export interface PointerTarget {
  /** The object under a point in normalised device coordinates (-1..1, y up), and where it was hit. */
  pickObject(xNdc: number, yNdc: number): { objectIndex: number; positionWorld: Vector3 } | null
  select(objectIndex: number): void
  beginDrag(objectIndex: number, positionWorld: Vector3): void
  dragTo(xNdc: number, yNdc: number): void
  /** Radians, counter-clockwise seen from above. */
  rotate(objectIndex: number, angle: number): void
  endDrag(objectIndex: number): void
}

const TAP_DISTANCE = 8
const TAP_MS = 400
/** A drag with shift over this many CSS pixels is a whole turn. */
const PIXELS_PER_TURN = 600

interface Finger {
  x: number
  y: number
}

export class PointerInput {
  readonly #element: HTMLElement
  readonly #target: PointerTarget
  readonly #abort = new AbortController()
  readonly #fingers = new Map<number, Finger>()
  #grabbed = -1
  #turning = false
  #twist: number | null = null
  #tap: { x: number; y: number; time: number } | null = null

  constructor(element: HTMLElement, target: PointerTarget) {
    this.#element = element
    this.#target = target
    const options = { capture: true, signal: this.#abort.signal }
    element.addEventListener('pointerdown', (event) => this.#down(event), options)
    element.addEventListener('pointermove', (event) => this.#move(event), options)
    element.addEventListener('pointerup', (event) => this.#up(event), options)
    element.addEventListener('pointercancel', (event) => this.#up(event), options)
    for (const type of ['keydown', 'blur']) {
      element.addEventListener(type, () => element.classList.remove('by-pointer'), options)
    }
  }

  dispose(): void {
    this.#abort.abort()
  }

  #down(event: PointerEvent): void {
    if (this.#grabbed >= 0) {
      this.#keep(event)
      this.#fingers.set(event.pointerId, { x: event.clientX, y: event.clientY })
      this.#twist = this.#currentTwist()
      return
    }
    this.#tap = { x: event.clientX, y: event.clientY, time: event.timeStamp }
    if (event.button !== 0 || !event.isPrimary) {
      return
    }
    const { x, y } = this.#ndc(event)
    const hit = this.#target.pickObject(x, y)
    if (!hit) {
      return
    }
    this.#keep(event)
    this.#fingers.set(event.pointerId, { x: event.clientX, y: event.clientY })
    this.#grabbed = hit.objectIndex
    this.#turning = event.shiftKey
    this.#target.select(hit.objectIndex)
    this.#target.beginDrag(hit.objectIndex, hit.positionWorld)
  }

  #move(event: PointerEvent): void {
    const finger = this.#fingers.get(event.pointerId)
    if (this.#grabbed < 0 || !finger) {
      return
    }
    event.stopImmediatePropagation()
    const dx = event.clientX - finger.x
    finger.x = event.clientX
    finger.y = event.clientY
    if (this.#fingers.size >= 2) {
      const twist = this.#currentTwist()
      if (this.#twist !== null && twist !== null) {
        this.#target.rotate(this.#grabbed, -angleDifference(this.#twist, twist))
      }
      this.#twist = twist
    } else if (this.#turning) {
      this.#target.rotate(this.#grabbed, (dx / PIXELS_PER_TURN) * 2 * Math.PI)
    } else {
      const { x, y } = this.#ndc(event)
      this.#target.dragTo(x, y)
    }
  }

  #up(event: PointerEvent): void {
    if (this.#grabbed < 0) {
      this.#finishTap(event)
      return
    }
    if (!this.#fingers.delete(event.pointerId)) {
      return
    }
    event.stopImmediatePropagation()
    this.#twist = null
    if (this.#fingers.size === 0) {
      this.#target.endDrag(this.#grabbed)
      this.#grabbed = -1
    } else {
      // The finger that remains goes on turning rather than pulling the object to where it happens to be.
      this.#turning = true
    }
  }

  /** A tap on the room deselects. */
  #finishTap(event: PointerEvent): void {
    const tap = this.#tap
    this.#tap = null
    if (
      event.type === 'pointerup' &&
      tap &&
      event.timeStamp - tap.time < TAP_MS &&
      Math.hypot(event.clientX - tap.x, event.clientY - tap.y) < TAP_DISTANCE
    ) {
      this.#target.select(-1)
    }
  }

  #keep(event: PointerEvent): void {
    event.stopImmediatePropagation()
    // A frame around the focused picture helps those who use keys; under a finger it only disturbs.
    this.#element.classList.add('by-pointer')
    this.#element.focus({ preventScroll: true })
    this.#element.setPointerCapture(event.pointerId)
  }

  #currentTwist(): number | null {
    const [first, second] = [...this.#fingers.values()]
    return first && second ? twistAngle(first.x, first.y, second.x, second.y) : null
  }

  #ndc(event: PointerEvent): { x: number; y: number } {
    const box = this.#element.getBoundingClientRect()
    return {
      x: ((event.clientX - box.left) / box.width) * 2 - 1,
      y: 1 - ((event.clientY - box.top) / box.height) * 2,
    }
  }
}

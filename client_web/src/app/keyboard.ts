/** Keys on the picture: an alternative to every gesture. */
import type { Viewer } from './viewer'

const ORBIT_STEP = Math.PI / 36
const DOLLY_STEP = 1.1

const ARROWS: Readonly<Record<string, readonly [number, number]>> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
}

/** Handles a key press; keys that mean nothing here are left to the browser. */
export function handleKey(event: KeyboardEvent, viewer: Viewer): void {
  if (event.ctrlKey || event.metaKey) {
    return
  }
  if (pressed(event, viewer)) {
    event.preventDefault()
    viewer.requestFrame()
  }
}

function pressed(event: KeyboardEvent, viewer: Viewer): boolean {
  const { objects, camera } = viewer
  const arrow = ARROWS[event.key]
  if (arrow) {
    const [right, away] = arrow
    if (objects.selected >= 0 && event.shiftKey && right !== 0) {
      objects.turnSelected(right)
      return true
    }
    if (objects.selected >= 0) {
      objects.stepSelected(right, away, camera.worldFromCamera(), event.altKey)
      return true
    }
    if (camera.view === 'free') {
      camera.orbitBy(-right * ORBIT_STEP, away * ORBIT_STEP)
      return true
    }
    return false
  }
  if (event.key === 'Escape') {
    objects.select(-1)
    return true
  }
  if (camera.view === 'free' && (event.key === '+' || event.key === '-')) {
    camera.dollyBy(event.key === '+' ? 1 / DOLLY_STEP : DOLLY_STEP)
    return true
  }
  const view = event.key === '0' ? 'free' : Number(event.key) - 1
  if (view === 'free' || (Number.isInteger(view) && view >= 0 && view < viewer.scene.views.length)) {
    viewer.selectView(view)
    return true
  }
  return false
}

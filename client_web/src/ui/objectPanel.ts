import type { ObjectDescription } from '../state/sceneDescription'
import { button } from './controls'
import { element } from './dom'
import { readableName } from './format'
import { icon } from './icons'
import { strings } from './strings'

export interface ObjectActions {
  selectObject(objectIndex: number): void
  /** Radians, counter-clockwise seen from above. */
  rotateObject(objectIndex: number, angle: number): void
  resetObject(objectIndex: number): void
}

export interface ObjectPanel {
  readonly element: HTMLElement
  setSelected(objectIndex: number): void
}

const TURN = Math.PI / 12

export function objectPanel(objects: readonly ObjectDescription[], actions: ObjectActions): ObjectPanel {
  if (objects.length === 0) {
    return {
      element: element(
        'div',
        { className: 'panel' },
        element('p', { className: 'hint' }, strings.objects.none),
      ),
      setSelected: () => undefined,
    }
  }
  let selected = -1
  const items = objects.map((each) => {
    const item = element(
      'button',
      { type: 'button', className: 'item', attributes: { 'aria-pressed': 'false' } },
      icon('cube'),
      element('span', { className: 'row-label' }, readableName(each.name)),
    )
    item.addEventListener('click', () => actions.selectObject(each.index === selected ? -1 : each.index))
    return item
  })
  const tools = [
    button(strings.objects.turnLeft, 'turnLeft', () => actions.rotateObject(selected, TURN)),
    button(strings.objects.turnRight, 'turnRight', () => actions.rotateObject(selected, -TURN)),
    button(strings.objects.reset, 'undo', () => actions.resetObject(selected)),
  ]
  const setSelected = (objectIndex: number): void => {
    selected = objectIndex
    items.forEach((item, index) => {
      item.setAttribute('aria-pressed', String(index === selected))
    })
    for (const tool of tools) {
      tool.disabled = selected < 0
    }
  }
  setSelected(-1)
  return {
    element: element(
      'div',
      { className: 'panel' },
      element('div', { className: 'items' }, ...items),
      element('div', { className: 'tools' }, ...tools),
      element('p', { className: 'hint' }, strings.objects.hintTouch),
      element('p', { className: 'hint hint-mouse' }, strings.objects.hintMouse),
    ),
    setSelected,
  }
}

import { type Switch, slider, switchRow } from './controls'
import { element } from './dom'
import { stops } from './format'
import { strings } from './strings'

/** What people can change about the picture. */
export interface PictureSettings {
  exposure: number
  autoExposure: boolean
  shadows: boolean
  indirectOcclusion: boolean
  antiAliasing: boolean
  showVals: boolean
}

export interface PicturePanel {
  readonly element: HTMLElement
  set(settings: PictureSettings): void
}

const TOGGLES = ['shadows', 'indirectOcclusion', 'antiAliasing', 'showVals'] as const
/** Range of the slider, stops around factor 1. */
const EXPOSURE_STOPS = 8

export function picturePanel(onChange: (change: Partial<PictureSettings>) => void): PicturePanel {
  const exposure = slider(
    strings.display.exposure,
    { min: -EXPOSURE_STOPS, max: EXPOSURE_STOPS, step: 0.1 },
    (value) => strings.display.stops(stops(2 ** value)),
    (value) => onChange({ exposure: 2 ** value, autoExposure: false }),
  )
  const automatic = switchRow(strings.display.automatic, true, (on) => onChange({ autoExposure: on }))
  const toggles = new Map<(typeof TOGGLES)[number], Switch>(
    TOGGLES.map((name) => [name, switchRow(strings.display[name], true, (on) => onChange({ [name]: on }))]),
  )
  return {
    element: element(
      'div',
      { className: 'panel' },
      element(
        'div',
        { className: 'lamp' },
        element('div', { className: 'row-label caption' }, strings.display.exposure),
        exposure.element,
        automatic.element,
      ),
      ...TOGGLES.map((name) => (toggles.get(name) as Switch).element),
    ),
    set: (settings) => {
      if (!exposure.input.matches(':active')) {
        exposure.set(Math.round(10 * Math.log2(settings.exposure)) / 10)
      }
      automatic.set(settings.autoExposure)
      for (const name of TOGGLES) {
        toggles.get(name)?.set(settings[name])
      }
    },
  }
}

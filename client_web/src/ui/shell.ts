/** The whole interface around the picture. It knows nothing about light, only what to show and whom to call. */
import type { SceneDescription } from '../state/sceneDescription'
import { type Segmented, segmented } from './controls'
import { element, setText } from './dom'
import { readableName, withAge } from './format'
import { type InfoNumbers, type InfoPanel, infoPanel } from './infoPanel'
import { type LampPanel, lampPanel } from './lampPanel'
import { Overlay, Toasts } from './messages'
import { type ObjectActions, type ObjectPanel, objectPanel } from './objectPanel'
import { type PicturePanel, type PictureSettings, picturePanel } from './picturePanel'
import { Sheet } from './sheet'
import { strings } from './strings'

/** A tablet view by its index, or the free camera. */
export type ViewChoice = number | 'free'

export interface ShellActions extends ObjectActions {
  selectView(view: ViewChoice): void
  setLightWeight(lightIndex: number, weight: number): void
  changePicture(change: Partial<PictureSettings>): void
  layoutChanged(): void
}

export type ConnectionTone = 'good' | 'waiting' | 'bad'

const INFO_PAGE = 3

export class Shell {
  readonly canvas: HTMLCanvasElement
  readonly toasts = new Toasts()
  readonly overlay = new Overlay()
  readonly #root: HTMLElement
  readonly stage: HTMLElement
  #controls: SceneControls | null = null

  constructor(root: HTMLElement) {
    this.#root = root
    this.canvas = element('canvas', {
      className: 'picture',
      tabIndex: 0,
      attributes: { 'aria-label': strings.picture, role: 'application' },
    })
    this.stage = element('main', { className: 'stage' }, this.canvas)
    root.replaceChildren(this.stage, this.toasts.element, this.overlay.element)
  }

  /** Adds the controls for a scene. */
  showScene(scene: SceneDescription, actions: ShellActions): SceneControls {
    this.#controls = new SceneControls(scene, actions)
    this.stage.before(this.#controls.topBar)
    this.stage.after(this.#controls.sheet.element)
    this.#root.classList.add('has-controls')
    return this.#controls
  }

  /** Space for the picture, CSS pixels. */
  stageSize(): { width: number; height: number } {
    return { width: this.stage.clientWidth, height: this.stage.clientHeight }
  }

  /** Lays the picture out: the largest size of this width to height ratio, or the whole stage for null. */
  fitPicture(aspect: number | null): { width: number; height: number } {
    const { width, height } = this.stageSize()
    const fitted =
      aspect === null
        ? { width, height }
        : { width: Math.min(width, height * aspect), height: Math.min(height, width / aspect) }
    this.canvas.style.width = `${fitted.width}px`
    this.canvas.style.height = `${fitted.height}px`
    return fitted
  }
}

export class SceneControls {
  readonly topBar: HTMLElement
  readonly sheet: Sheet
  readonly #views: Segmented
  readonly #numViews: number
  readonly #lamps: LampPanel
  readonly #objects: ObjectPanel
  readonly #picture: PicturePanel
  readonly #info: InfoPanel
  readonly #chip: HTMLButtonElement
  readonly #chipText = element('span')

  constructor(scene: SceneDescription, actions: ShellActions) {
    this.#numViews = scene.views.length
    this.#views = segmented(
      strings.views.title,
      [
        ...scene.views.map((view) => ({
          short: strings.views.tablet(view.index + 1),
          tiny: String(view.index + 1),
          long: strings.views.tabletLong(view.index + 1),
        })),
        { short: strings.views.free, tiny: strings.views.free, long: strings.views.freeLong },
      ],
      (index) => actions.selectView(index < this.#numViews ? index : 'free'),
    )
    this.#chip = element(
      'button',
      { type: 'button', className: 'chip' },
      element('span', { className: 'chip-dot' }),
      this.#chipText,
    )
    this.#chip.addEventListener('click', () => {
      this.sheet.show(INFO_PAGE)
      this.sheet.setOpen(true)
    })
    this.topBar = element('header', { className: 'top-bar' }, this.#views.element, this.#chip)
    this.#lamps = lampPanel(scene.lights, (index, weight) => actions.setLightWeight(index, weight))
    this.#objects = objectPanel(scene.objects, actions)
    this.#picture = picturePanel((change) => actions.changePicture(change))
    this.#info = infoPanel(scene.objects.map((each) => readableName(each.name)))
    this.sheet = new Sheet(
      [
        { label: strings.lamps.tab, icon: 'lamp', content: this.#lamps.element },
        { label: strings.objects.tab, icon: 'cube', content: this.#objects.element },
        { label: strings.display.tab, icon: 'picture', content: this.#picture.element },
        { label: strings.info.tab, icon: 'pulse', content: this.#info.element },
      ],
      () => actions.layoutChanged(),
    )
  }

  setView(view: ViewChoice): void {
    this.#views.set(view === 'free' ? this.#numViews : view)
  }

  setLightWeight(lightIndex: number, weight: number): void {
    this.#lamps.setWeight(lightIndex, weight)
  }

  setSelectedObject(objectIndex: number): void {
    this.#objects.setSelected(objectIndex)
  }

  setPicture(settings: PictureSettings): void {
    this.#picture.set(settings)
  }

  /** The state of the connection at a glance; the age is shown only while the light is live, and old enough to matter. */
  setConnection(tone: ConnectionTone, text: string, ageMs: number | null): void {
    this.#chip.dataset.tone = tone
    setText(this.#chipText, withAge(text, ageMs))
  }

  /** Whether the page of numbers is in sight; nobody needs them otherwise. */
  get isInfoShown(): boolean {
    return this.sheet.isShowing(INFO_PAGE)
  }

  setInfo(numbers: InfoNumbers): void {
    this.#info.set(numbers)
  }
}

/** The page on which a person connects cameras and writes the room file. */
import { button } from '../ui/controls'
import { element, setText } from '../ui/dom'
import { CameraCard } from './cameraCard'
import { freeNames, mayJoin, readState, type SetupState, writeRoom } from './model'
import { RoomCard } from './roomCard'
import { words } from './words'

class SetupPage {
  readonly #notice = element('p', { className: 'notice', attributes: { role: 'status' } }, words.searching)
  readonly #grid = element('section', { className: 'cards setup' })
  readonly #room = new RoomCard(() => this.#write())
  readonly #search: HTMLButtonElement
  #cards: readonly CameraCard[] = []

  constructor(root: HTMLElement) {
    this.#search = button(words.search, null, () => this.refresh(true))
    root.append(
      element(
        'header',
        { className: 'page-bar' },
        element('h1', {}, words.title),
        element('nav', {}, this.#search),
      ),
      element('p', { className: 'lead' }, words.lead),
      this.#notice,
      this.#grid,
      this.#room.element,
    )
  }

  async refresh(searchAgain: boolean): Promise<void> {
    this.#search.disabled = true
    this.#tell(words.searching)
    const answer = await readState(searchAgain)
    this.#search.disabled = false
    if ('error' in answer) {
      this.#tell(answer.error)
      return
    }
    this.#show(answer.value)
  }

  look(): void {
    const nowMs = performance.now()
    for (const card of this.#cards) {
      card.look(nowMs)
    }
  }

  #show(state: SetupState): void {
    this.#tell([...(state.cameras.length === 0 ? [words.none] : []), ...state.notes].join(' '))
    const names = freeNames(state.room.camera_ids, state.cameras.length)
    this.#cards = state.cameras.map(
      (camera) => new CameraCard(camera, mayJoin(camera) ? (names.shift() ?? '') : ''),
    )
    this.#grid.replaceChildren(...this.#cards.map((card) => card.element))
    this.#room.show(state)
  }

  async #write(): Promise<void> {
    const chosen = this.#cards.filter((card) => card.choice !== null)
    const cameras = chosen.flatMap((card) => card.choice ?? [])
    const ids = new Set(cameras.map((camera) => camera.id))
    if (cameras.length === 0) {
      this.#room.tell('bad', words.room.noneChosen)
      return
    }
    if (ids.size < cameras.length || !chosen.every((card) => card.hasGoodName)) {
      this.#room.tell('bad', words.room.wrongName)
      return
    }
    this.#room.busy(true)
    const answer = await writeRoom({ cameras, name: this.#room.name, model: this.#room.model })
    this.#room.busy(false)
    if ('error' in answer) {
      this.#room.tell('bad', answer.error)
      return
    }
    const { path, cameras: all, next } = answer.value
    this.#room.tell('good', words.room.done(path, all.join(', '), next))
    await this.refresh(false)
  }

  #tell(text: string): void {
    setText(this.#notice, text)
    this.#notice.hidden = text === ''
  }
}

const root = document.getElementById('setup')
if (root === null) {
  throw new Error('setup.html has no element #setup')
}
const page = new SetupPage(root)
page.refresh(false)
setInterval(() => page.look(), 100)

/** The room file: what it will be, and the button that writes it. */
import { button } from '../ui/controls'
import { element, setText } from '../ui/dom'
import { choice, field, textInput } from './form'
import type { SetupState } from './model'
import { words } from './words'

export class RoomCard {
  readonly element: HTMLElement
  readonly #about = element('p', { className: 'where' })
  readonly #form = element('div')
  readonly #outcome = element('p', {
    className: 'outcome',
    hidden: true,
    attributes: { role: 'status', 'aria-live': 'polite' },
  })
  readonly #button: HTMLButtonElement
  readonly #label: HTMLElement
  #name = textInput('', null)
  #model = choice([], null)

  constructor(onWrite: () => void) {
    this.#button = button(words.room.write, null, onWrite)
    this.#label = this.#button.firstElementChild as HTMLElement
    this.element = element(
      'section',
      { className: 'card room', attributes: { 'aria-label': words.room.title } },
      element('header', {}, element('h3', {}, words.room.title)),
      this.#about,
      this.#form,
      this.#button,
      this.#outcome,
    )
  }

  get name(): string {
    return this.#name.value
  }

  get model(): string {
    return this.#model.value
  }

  show(state: SetupState): void {
    const { room } = state
    setText(
      this.#about,
      room.problem ||
        (room.exists
          ? words.room.exists(room.path, room.camera_ids.join(', '))
          : words.room.isNew(room.path)),
    )
    setText(this.#label, room.exists ? words.room.add : words.room.write)
    this.#button.disabled = room.problem !== '' || (!room.exists && state.models.length === 0)
    const [name, model] = [this.name, this.model]
    this.#name = textInput(name, null)
    this.#name.placeholder = room.default_name
    this.#model = choice(state.models, state.models.includes(model) ? model : null)
    this.#form.replaceChildren()
    if (!room.exists && state.models.length === 0) {
      this.#form.append(element('p', { className: 'words' }, words.room.noModel))
    } else if (!room.exists) {
      this.#form.append(field(words.room.name, this.#name), field(words.room.model, this.#model))
    }
  }

  busy(isBusy: boolean): void {
    this.#button.disabled = isBusy
  }

  tell(tone: 'good' | 'bad', text: string): void {
    this.#outcome.dataset.tone = tone
    this.#outcome.hidden = text === ''
    setText(this.#outcome, text)
  }
}

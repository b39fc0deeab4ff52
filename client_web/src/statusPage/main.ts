/** The page for whoever runs the service: cameras, light, processes, and the last minutes of each. */
import { element, setText } from '../ui/dom'
import { CameraCard } from './cameraCard'
import { type History, parseHistory, parseStatus, type Status } from './model'
import { LightCard, ProcessCard, RecordingCard } from './serviceCards'
import { words } from './words'

const STATUS_PERIOD_MS = 1000
const HISTORY_PERIOD_MS = 2000

class StatusPage {
  readonly #notice = element('p', { className: 'notice', attributes: { role: 'status' } }, words.waiting)
  readonly #cameras = element('section', {
    className: 'cards cameras',
    attributes: { 'aria-label': words.cameras },
  })
  readonly #light = new LightCard()
  readonly #processes = new ProcessCard()
  readonly #recording = new RecordingCard()
  readonly #cards = new Map<string, CameraCard>()

  constructor(root: HTMLElement) {
    root.append(
      element(
        'header',
        { className: 'page-bar' },
        element('h1', {}, words.title),
        element(
          'nav',
          {},
          element('a', { href: './' }, words.back),
          element('a', { href: './api/status' }, words.json),
          element('a', { href: './metrics' }, words.metrics),
        ),
      ),
      this.#notice,
      this.#cameras,
      element(
        'section',
        { className: 'cards' },
        this.#light.element,
        this.#processes.element,
        this.#recording.element,
      ),
    )
  }

  showStatus(status: Status | null): void {
    if (status === null) {
      this.#tell(words.noAnswer)
      return
    }
    this.#tell(status.cameras.length === 0 ? words.noCameras : '')
    for (const camera of status.cameras) {
      this.#card(camera.id).show(camera)
    }
    this.#light.show(status)
    this.#processes.show(status.processes)
    this.#recording.show(status.recording)
  }

  showHistory(history: History): void {
    for (const [id, card] of this.#cards) {
      card.showHistory(history, id)
    }
    this.#light.showHistory(history)
  }

  look(nowMs: number): void {
    for (const card of this.#cards.values()) {
      card.preview.look(nowMs)
    }
  }

  #tell(text: string): void {
    setText(this.#notice, text)
    this.#notice.hidden = text === ''
  }

  #card(id: string): CameraCard {
    let card = this.#cards.get(id)
    if (card === undefined) {
      card = new CameraCard(id)
      this.#cards.set(id, card)
      this.#cameras.append(card.element)
    }
    return card
  }
}

/** Asks again and again while the page can be seen; a question never overtakes another. */
function ask(url: string, periodMs: number, take: (json: unknown) => void): void {
  const again = async (): Promise<void> => {
    if (!document.hidden) {
      take(
        await fetch(url)
          .then(
            (response) => response.json(),
            () => null,
          )
          .catch(() => null),
      )
    }
    setTimeout(again, periodMs)
  }
  again()
}

const root = document.getElementById('status')
if (root === null) {
  throw new Error('status.html has no element #status')
}
const page = new StatusPage(root)
ask('api/status', STATUS_PERIOD_MS, (json) => {
  page.showStatus(parseStatus(json))
  page.look(performance.now())
})
ask('api/history', HISTORY_PERIOD_MS, (json) => {
  const history = parseHistory(json)
  if (history !== null) {
    page.showHistory(history)
  }
})

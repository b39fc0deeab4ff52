/** Puts the page together. */
import { parseSceneDescription, type SceneDescription } from '../state/sceneDescription'
import { Shell } from '../ui/shell'
import { strings } from '../ui/strings'
import type { Platform, RendererSettings } from './ports'
import { StatusDisplay } from './statusDisplay'
import { createTestApi } from './testApi'
import { Viewer, type ViewerOptions } from './viewer'
import { keepScreenOn } from './wakeLock'

const SCENE_URL = 'api/scene'
const RETRY_MS = 2000

/** A failure with words for people; the page shows them. */
class StartError extends Error {
  override readonly name = 'StartError'

  constructor(
    readonly title: string,
    message: string,
  ) {
    super(message)
  }
}

/**
 * Starts the page in `root` and offers `window.nearfield`.
 *
 * @param search query of the address; `?mode=evaluate` is how `nearfield evaluate` opens the page.
 */
export function startApp(root: HTMLElement, platform: Platform, search: string): void {
  const options: ViewerOptions = { evaluate: new URLSearchParams(search).get('mode') === 'evaluate' }
  const shell = new Shell(root)
  const starting = start(shell, platform, options)
  window.nearfield = createTestApi(starting, platform)
  starting.catch((error: unknown) => {
    const title = error instanceof StartError ? error.title : strings.messages.drawTitle
    shell.overlay.fail(title, wordsOf(error), () => window.location.reload())
  })
}

async function start(shell: Shell, platform: Platform, options: ViewerOptions): Promise<Viewer> {
  shell.overlay.progress(strings.messages.loading, null)
  requireWebgl()
  const scene = await loadScene(shell)
  if (scene.protocol_version !== platform.protocolVersion) {
    throw new StartError(strings.messages.versionTitle, strings.messages.version)
  }
  const settings: RendererSettings = {
    exposure: scene.settings.exposure ?? 1,
    shadows: true,
    indirectOcclusion: true,
    showVals: false,
    selectedObject: -1,
    antiAliasing: true,
    fullQuality: options.evaluate,
  }
  const { renderer, roomTriangles } = await platform.createRenderer(
    shell.canvas,
    scene,
    settings,
    (loaded, total) => {
      const title = loaded < total ? strings.messages.loading : strings.messages.preparing
      shell.overlay.progress(title, total > 0 ? Math.min(1, loaded / total) : null)
    },
  )
  const reload = (): void => window.location.reload()
  const viewer = new Viewer(shell, scene, renderer, roomTriangles, settings, options, {
    drawingFailed: (error) => shell.overlay.fail(strings.messages.drawTitle, wordsOf(error), reload),
    roomChanged: () =>
      shell.overlay.fail(strings.messages.roomChangedTitle, strings.messages.roomChanged, reload),
  })
  watchContext(shell, viewer)
  const status = new StatusDisplay(shell, viewer)
  if (!options.evaluate) {
    viewer.show()
    watchPage(shell, viewer)
  }
  viewer.connect(
    (events) => platform.connect(events),
    (state) => status.connectionChanged(state),
    (text) => status.messageRefused(text),
  )
  shell.overlay.hide()
  return viewer
}

/** Fetches the scene; a server that does not answer yet is asked again. */
async function loadScene(shell: Shell): Promise<SceneDescription> {
  for (;;) {
    const json = await fetchScene()
    if (json !== undefined) {
      try {
        return parseSceneDescription(json)
      } catch (error) {
        throw new StartError(strings.messages.sceneTitle, wordsOf(error))
      }
    }
    shell.overlay.fail(strings.messages.sceneTitle, strings.messages.noServer, () => window.location.reload())
    await new Promise((resolve) => window.setTimeout(resolve, RETRY_MS))
    shell.overlay.progress(strings.messages.loading, null)
  }
}

/** The JSON of the scene, or undefined if the server does not answer or is not ready. */
async function fetchScene(): Promise<unknown> {
  try {
    const response = await fetch(SCENE_URL, { headers: { Accept: 'application/json' } })
    return response.ok ? ((await response.json()) as unknown) : undefined
  } catch {
    return undefined
  }
}

function requireWebgl(): void {
  const context = document.createElement('canvas').getContext('webgl2')
  if (!context) {
    throw new StartError(strings.messages.noWebglTitle, strings.messages.noWebgl)
  }
  context.getExtension('WEBGL_lose_context')?.loseContext()
}

/** The renderer rebuilds itself when the context comes back; until then there is nothing to draw with. */
function watchContext(shell: Shell, viewer: Viewer): void {
  shell.canvas.addEventListener('webglcontextlost', (event) => {
    event.preventDefault()
    viewer.pause()
    shell.overlay.fail(strings.messages.contextLostTitle, strings.messages.contextLost, () =>
      window.location.reload(),
    )
  })
  shell.canvas.addEventListener('webglcontextrestored', () => {
    shell.overlay.hide()
    viewer.resume()
  })
}

function watchPage(shell: Shell, viewer: Viewer): void {
  new ResizeObserver(() => viewer.layoutChanged()).observe(shell.stage)
  document.addEventListener('visibilitychange', () => {
    if (document.hidden) {
      viewer.pause()
    } else {
      viewer.resume()
    }
  })
  keepScreenOn(shell.canvas)
}

function wordsOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error)
}

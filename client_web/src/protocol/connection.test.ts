import { describe, expect, it, vi } from 'vitest'
import {
  type ConnectionEvents,
  type PageEvents,
  ServerConnection,
  type WorkerPort,
  websocketUrl,
} from './connection'
import type { FromWorker, ToWorker } from './connection.worker'

class Page implements PageEvents {
  readonly listeners = new Map<string, () => void>()
  addEventListener(type: string, listener: () => void): void {
    this.listeners.set(type, listener)
  }
  removeEventListener(type: string): void {
    this.listeners.delete(type)
  }
}

function setUp() {
  const posted: ToWorker[] = []
  const worker: WorkerPort = {
    onmessage: null,
    postMessage: (message) => posted.push(message),
    terminate: vi.fn(),
  }
  const events = {
    state: vi.fn(),
    light: vi.fn(),
    atlas: vi.fn(),
    controlState: vi.fn(),
    status: vi.fn(),
    refused: vi.fn(),
  } satisfies ConnectionEvents
  const page = { window: new Page(), document: new Page() }
  const connection = new ServerConnection(events, 'ws://desk/ws', worker, page)
  const emit = (data: FromWorker) => worker.onmessage?.({ data } as MessageEvent<FromWorker>)
  return { posted, worker, events, page, connection, emit }
}

describe('websocketUrl', () => {
  it.each([
    ['http://127.0.0.1:8080/', 'ws://127.0.0.1:8080/ws'],
    ['https://desk.example/room/?a=1#x', 'wss://desk.example/room/ws'],
    ['http://[::1]:8080/index.html', 'ws://[::1]:8080/ws'],
  ])('%s', (page, expected) => {
    expect(websocketUrl(page)).toBe(expected)
  })
})

describe('ServerConnection', () => {
  it('starts, forwards requests, and wakes with the page', () => {
    const { posted, page, connection } = setUp()
    connection.setLightWeight(1, 0.5)
    connection.setObjectPose(0, [1, 2, 3], [0, 0, 0, 1])
    connection.wantAtlas(true)
    page.document.listeners.get('visibilitychange')?.()
    page.window.listeners.get('pageshow')?.()
    page.window.listeners.get('online')?.()
    expect(posted).toEqual([
      { type: 'start', url: 'ws://desk/ws' },
      { type: 'request', message: { type: 'setLightWeight', lightIndex: 1, weight: 0.5 } },
      {
        type: 'request',
        message: { type: 'setObjectPose', objectIndex: 0, position: [1, 2, 3], quaternion: [0, 0, 0, 1] },
      },
      { type: 'request', message: { type: 'subscribe', encoding: 1, wantsAtlas: true } },
      { type: 'resume' },
      { type: 'resume' },
      { type: 'resume' },
    ])
  })

  it('hands out what the worker reports', () => {
    const { events, emit } = setUp()
    emit({ type: 'state', state: { kind: 'live' } })
    emit({ type: 'refused', text: 'magic' })
    const status = { sequence: 1, serverTimeNs: 0n, lightAge: 0, cameraAges: [], isStale: false }
    emit({ type: 'message', message: { type: 'status', status } })
    const state = { sequence: 1, revision: 2, lightWeights: [], objectPoses: [] }
    emit({ type: 'message', message: { type: 'controlState', state } })
    expect(events.state).toHaveBeenCalledWith({ kind: 'live' })
    expect(events.refused).toHaveBeenCalledWith('magic')
    expect(events.status).toHaveBeenCalledWith(status)
    expect(events.controlState).toHaveBeenCalledWith(state)
  })

  it('leaves nothing behind', () => {
    const { posted, worker, page, connection } = setUp()
    connection.dispose()
    expect(posted.at(-1)).toEqual({ type: 'dispose' })
    expect(worker.terminate).toHaveBeenCalledOnce()
    expect(page.window.listeners.size + page.document.listeners.size).toBe(0)
  })
})

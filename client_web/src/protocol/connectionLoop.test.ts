import { describe, expect, it } from 'vitest'
import { decodeClientMessage, encodeStatus } from './codec'
import { ConnectionLoop, type ConnectionState, type Environment, type Socket } from './connectionLoop'

const status = () =>
  encodeStatus({ sequence: 1, serverTimeNs: 0n, lightAge: 0, cameraAges: [], isStale: false })

class FakeSocket implements Socket {
  binaryType = ''
  onmessage: ((event: { data: unknown }) => void) | null = null
  onclose: ((event: { code: number; reason: string }) => void) | null = null
  readonly sent: ArrayBuffer[] = []
  closed = false
  send(data: ArrayBuffer): void {
    this.sent.push(data)
  }
  close(): void {
    this.closed = true
  }
}

/** A world without time: `advance` runs due timers in order. */
class World implements Environment {
  now = 0
  chance = 1
  readonly sockets: FakeSocket[] = []
  readonly states: ConnectionState[] = []
  readonly refused: string[] = []
  messages = 0
  #timers = new Map<number, { at: number; callback: () => void }>()
  #nextTimer = 1
  readonly loop = new ConnectionLoop(
    'ws://desk/ws',
    {
      state: (state) => this.states.push(state),
      message: () => this.messages++,
      refused: (text) => this.refused.push(text),
    },
    this,
  )
  openSocket(): Socket {
    const socket = new FakeSocket()
    this.sockets.push(socket)
    return socket
  }
  nowMs = () => this.now
  random = () => this.chance
  setTimeout(callback: () => void, delayMs: number): number {
    this.#timers.set(this.#nextTimer, { at: this.now + delayMs, callback })
    return this.#nextTimer++
  }
  clearTimeout(handle: number): void {
    this.#timers.delete(handle)
  }
  get numTimers(): number {
    return this.#timers.size
  }
  advance(ms: number): void {
    const end = this.now + ms
    for (;;) {
      const due = [...this.#timers]
        .filter(([, timer]) => timer.at <= end)
        .sort(([, a], [, b]) => a.at - b.at)[0]
      if (due === undefined) break
      this.#timers.delete(due[0])
      this.now = due[1].at
      due[1].callback()
    }
    this.now = end
  }
  get socket(): FakeSocket {
    return this.sockets.at(-1) as FakeSocket
  }
  get state(): ConnectionState {
    return this.states.at(-1) as ConnectionState
  }
  hear(): void {
    this.socket.onmessage?.({ data: status() })
  }
}

function live(): World {
  const world = new World()
  world.loop.start()
  world.hear()
  return world
}

describe('ConnectionLoop', () => {
  it('is live with the first message', () => {
    const world = new World()
    world.loop.start()
    expect(world.state.kind).toBe('connecting')
    world.hear()
    expect(world.state.kind).toBe('live')
    expect(world.messages).toBe(1)
  })

  it('waits 0.5, 1, 2, 4, 8, 8 s, and begins again after a success', () => {
    const world = live()
    const waits: number[] = []
    for (let i = 0; i < 6; i++) {
      world.socket.onclose?.({ code: 1006, reason: '' })
      const { retryMs } = world.state as { retryMs: number }
      waits.push(retryMs)
      world.advance(retryMs)
      expect(world.state.kind).toBe('connecting')
    }
    expect(waits).toEqual([500, 1000, 2000, 4000, 8000, 8000])
    world.hear()
    world.socket.onclose?.({ code: 1012, reason: '' })
    expect(world.state).toEqual({ kind: 'waiting', retryMs: 500 })
  })

  it('spreads retries over half of the wait', () => {
    const world = live()
    world.chance = 0
    world.socket.onclose?.({ code: 1006, reason: '' })
    expect(world.state).toEqual({ kind: 'waiting', retryMs: 250 })
  })

  it('gives up a connection attempt after 5 s', () => {
    const world = new World()
    world.loop.start()
    world.advance(5200)
    expect(world.sockets[0]?.closed).toBe(true)
    expect(world.state.kind).toBe('waiting')
    world.advance(500)
    expect(world.sockets).toHaveLength(2)
  })

  it('reopens a connection that fell silent', () => {
    const world = live()
    world.advance(3000)
    expect(world.state.kind).toBe('live')
    world.advance(2200)
    expect(world.state.kind).toBe('waiting')
  })

  it.each([
    [4001, 'version', 'this page speaks nearfield.v1, the server nearfield.v2: reload the page'],
    [4013, 'full', '32 tablets are connected'],
    [4002, 'other', 'magic at byte 0'],
  ] as const)('%i ends it with the words of the server', (code, reason, text) => {
    const world = new World()
    world.loop.start()
    world.socket.onclose?.({ code, reason: text })
    expect(world.state).toEqual({ kind: 'closed', reason, text })
    world.advance(60_000)
    world.loop.resume()
    expect(world.sockets).toHaveLength(1)
    expect(world.numTimers).toBe(0)
  })

  it('resumes at once when the page comes back', () => {
    const world = live()
    for (let i = 0; i < 4; i++) {
      world.socket.onclose?.({ code: 1006, reason: '' })
      world.advance(i < 3 ? 8000 : 0)
    }
    const before = world.sockets.length
    world.loop.resume()
    expect(world.sockets).toHaveLength(before + 1)
  })

  it('resumes a sleeping connection, not a lively one or one that is being opened', () => {
    const world = live()
    world.loop.resume()
    expect(world.sockets).toHaveLength(1)
    world.now += 60_000
    world.loop.resume()
    expect(world.sockets).toHaveLength(2)
    world.loop.resume()
    expect(world.sockets).toHaveLength(2)
  })

  it('sends requests, later if it must', () => {
    const world = new World()
    world.loop.start()
    world.loop.request({ type: 'setLightWeight', lightIndex: 0, weight: 0.5 })
    expect(world.socket.sent).toHaveLength(0)
    world.hear()
    expect(world.socket.sent).toHaveLength(1)
    for (let i = 0; i < 20; i++) world.loop.request({ type: 'setLightWeight', lightIndex: i, weight: 0.5 })
    expect(world.socket.sent.length).toBeLessThan(21)
    world.advance(1200)
    const indices = world.socket.sent.map((data) => decodeClientMessage(data).message)
    expect(indices).toHaveLength(21)
  })

  it('leaves out what it cannot read', () => {
    const world = live()
    world.socket.onmessage?.({ data: new ArrayBuffer(3) })
    world.socket.onmessage?.({ data: 'text' })
    expect(world.refused).toHaveLength(2)
    expect(world.state.kind).toBe('live')
  })

  it('leaves nothing behind', () => {
    const world = live()
    world.loop.dispose()
    expect(world.socket.closed).toBe(true)
    expect(world.numTimers).toBe(0)
    world.loop.resume()
    expect(world.sockets).toHaveLength(1)
  })
})

import { readFileSync } from 'node:fs'
import { afterEach, describe, expect, it, vi } from 'vitest'
import { type FromWorker, serveWorker, type ToWorker, transferables } from './connection.worker'

function vector(name: string): ArrayBuffer {
  const bytes = readFileSync(new URL(`../../../protocol/vectors/${name}.bin`, import.meta.url))
  return bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength) as ArrayBuffer
}

class FakeWebSocket {
  static last: FakeWebSocket
  binaryType = 'blob'
  onmessage: ((event: { data: unknown }) => void) | null = null
  onclose: ((event: { code: number; reason: string }) => void) | null = null
  readonly sent: ArrayBuffer[] = []
  close = vi.fn()
  constructor(
    readonly url: string,
    readonly protocol: string,
  ) {
    FakeWebSocket.last = this
  }
  send(data: ArrayBuffer): void {
    this.sent.push(data)
  }
}

afterEach(() => vi.unstubAllGlobals())

describe('the worker', () => {
  it('opens the socket, decodes, acknowledges and hands buffers over', () => {
    vi.stubGlobal('WebSocket', FakeWebSocket)
    const posted: [FromWorker, ArrayBuffer[]][] = []
    const scope = {
      onmessage: null as ((event: MessageEvent<ToWorker>) => void) | null,
      postMessage: (message: FromWorker, transfer: ArrayBuffer[]) => posted.push([message, transfer]),
    }
    serveWorker(scope)
    const post = (data: ToWorker) => scope.onmessage?.({ data } as MessageEvent<ToWorker>)
    post({ type: 'start', url: 'ws://desk/ws' })
    const socket = FakeWebSocket.last
    expect([socket.url, socket.protocol, socket.binaryType]).toEqual([
      'ws://desk/ws',
      'nearfield.v1',
      'arraybuffer',
    ])
    socket.onmessage?.({ data: vector('light_typical_compact') })
    expect(socket.sent).toHaveLength(1)
    expect(posted.map(([message]) => message.type)).toEqual(['state', 'state', 'message'])
    const [message, transfer] = posted[2] as [FromWorker, ArrayBuffer[]]
    expect(message).toMatchObject({ message: { type: 'light', numBytes: 396 } })
    expect(transfer).toHaveLength(4)
    post({ type: 'request', message: { type: 'setLightWeight', lightIndex: 0, weight: 1 } })
    expect(socket.sent).toHaveLength(2)
    post({ type: 'resume' })
    post({ type: 'dispose' })
    expect(socket.close).toHaveBeenCalledOnce()
  })

  it('copies small messages', () => {
    const status = { sequence: 1, serverTimeNs: 0n, lightAge: 0, cameraAges: [], isStale: false }
    expect(transferables({ type: 'status', status })).toEqual([])
  })
})

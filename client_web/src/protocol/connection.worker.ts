// The websocket and the decoding live in a worker: a long frame does not delay acknowledgements.

import { ConnectionLoop, type ConnectionState, type Socket } from './connectionLoop'
import type { ClientMessage } from './messages'
import type { ServerMessage } from './session'

export type ToWorker =
  | { readonly type: 'start'; readonly url: string }
  | { readonly type: 'request'; readonly message: ClientMessage }
  | { readonly type: 'resume' }
  | { readonly type: 'dispose' }

export type FromWorker =
  | { readonly type: 'state'; readonly state: ConnectionState }
  | { readonly type: 'message'; readonly message: ServerMessage }
  | { readonly type: 'refused'; readonly text: string }

/** Buffers that are handed over instead of copied. */
export function transferables(message: ServerMessage): ArrayBuffer[] {
  if (message.type === 'light') {
    const { vals, generations, objectSh, objectRevisions } = message.packet
    return [vals, generations, objectSh, objectRevisions].map((array) => array.buffer as ArrayBuffer)
  }
  return message.type === 'atlas' ? [message.tiles.texels.buffer as ArrayBuffer] : []
}

interface WorkerScope {
  onmessage: ((event: MessageEvent<ToWorker>) => void) | null
  postMessage(message: FromWorker, transfer: ArrayBuffer[]): void
}

/** Make a worker's scope serve one connection. */
export function serveWorker(scope: WorkerScope): void {
  let loop: ConnectionLoop | null = null
  scope.onmessage = ({ data }) => {
    switch (data.type) {
      case 'start':
        loop = new ConnectionLoop(
          data.url,
          {
            state: (state) => scope.postMessage({ type: 'state', state }, []),
            message: (message) => scope.postMessage({ type: 'message', message }, transferables(message)),
            refused: (text) => scope.postMessage({ type: 'refused', text }, []),
          },
          {
            openSocket: (url, subprotocol) => new WebSocket(url, subprotocol) as unknown as Socket,
            nowMs: () => performance.now(),
            setTimeout: (callback, delayMs) => setTimeout(callback, delayMs) as unknown as number,
            clearTimeout: (handle) => clearTimeout(handle),
            random: () => Math.random(),
          },
        )
        loop.start()
        break
      case 'request':
        loop?.request(data.message)
        break
      case 'resume':
        loop?.resume()
        break
      case 'dispose':
        loop?.dispose()
        break
    }
  }
}

declare const WorkerGlobalScope: unknown
if (typeof WorkerGlobalScope !== 'undefined') serveWorker(self as unknown as WorkerScope)

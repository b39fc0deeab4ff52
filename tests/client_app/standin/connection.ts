/** A bare connection: no retries beyond a fixed one, no acknowledgements. */
import type { Connection, ConnectionEvents } from '../../../client_web/src/app/ports'
import {
  decodeControlState,
  decodeLightPacket,
  decodeStatus,
  encodeClientMessage,
  MessageType,
  peekHeader,
  SUBPROTOCOL,
} from '../../../client_web/src/protocol/codec'

export function connect(events: ConnectionEvents): Connection {
  let socket: WebSocket
  let sequence = 0
  const open = (): void => {
    events.state({ kind: 'connecting' })
    socket = new WebSocket(new URL('ws', window.location.href.replace(/^http/, 'ws')), SUBPROTOCOL)
    socket.binaryType = 'arraybuffer'
    socket.onopen = () => events.state({ kind: 'live' })
    socket.onmessage = ({ data }: MessageEvent<ArrayBuffer>) => {
      const { messageType } = peekHeader(data)
      if (messageType === MessageType.LIGHT_PACKET) events.light(decodeLightPacket(data), data.byteLength)
      if (messageType === MessageType.CONTROL_STATE) events.controlState(decodeControlState(data))
      if (messageType === MessageType.STATUS) events.status(decodeStatus(data))
    }
    socket.onclose = ({ code, reason }) => {
      if (code === 4013) return events.state({ kind: 'closed', reason: 'full', text: reason })
      events.state({ kind: 'waiting', retryMs: 300 })
      window.setTimeout(open, 300)
    }
  }
  open()
  const send = (message: Parameters<typeof encodeClientMessage>[0]): void => {
    if (socket.readyState === WebSocket.OPEN) socket.send(encodeClientMessage(message, sequence++))
  }
  return {
    setLightWeight: (lightIndex, weight) => send({ type: 'setLightWeight', lightIndex, weight }),
    setObjectPose: (objectIndex, position, quaternion) =>
      send({ type: 'setObjectPose', objectIndex, position, quaternion }),
    wantAtlas: () => undefined,
    dispose: () => socket.close(),
  }
}

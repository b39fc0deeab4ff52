import { startApp } from '../../../client_web/src/app/start'
import { decodeLightPacket, VERSION } from '../../../client_web/src/protocol/codec'
import { ServerConnection } from '../../../client_web/src/protocol/connection'
import { StandInRenderer } from './renderer'

declare global {
  interface Window {
    standIn: StandInRenderer
  }
}

startApp(
  document.getElementById('app') as HTMLElement,
  {
    protocolVersion: VERSION,
    decodeLightPacket,
    connect: (events) => new ServerConnection(events),
    createRenderer: async (canvas, scene, settings) => {
      window.standIn = new StandInRenderer(canvas, scene, settings)
      const floor = { positions: [0, 0, 0, 0, 0, 4, 4, 0, 4, 4, 0, 0], indices: [0, 1, 2, 0, 2, 3] }
      return {
        renderer: window.standIn,
        roomTriangles: {
          positions: new Float32Array(floor.positions),
          indices: new Uint32Array(floor.indices),
        },
      }
    },
  },
  window.location.search,
)

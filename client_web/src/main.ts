import { startApp } from './app/start'
import { decodeLightPacket, VERSION } from './protocol/codec'
import { ServerConnection } from './protocol/connection'
import { loadSceneAssets } from './render/assets'
import { Renderer } from './render/renderer'

startApp(
  document.getElementById('app') as HTMLElement,
  {
    protocolVersion: VERSION,
    decodeLightPacket,
    connect: (events) => new ServerConnection(events),
    createRenderer: async (canvas, scene, settings, onProgress) => {
      const assets = await loadSceneAssets(scene, onProgress)
      return {
        renderer: await Renderer.create(canvas, assets, settings),
        roomTriangles: assets.roomTriangles,
      }
    },
  },
  window.location.search,
)

/** The shader files, with `#include <chunk>` resolved. */
import background from './shaders/background.frag?raw'
import bits from './shaders/chunks/bits.glsl?raw'
import compositeChunk from './shaders/chunks/composite.glsl?raw'
import indirectExchange from './shaders/chunks/indirect_exchange.glsl?raw'
import objectData from './shaders/chunks/object_data.glsl?raw'
import octahedral from './shaders/chunks/octahedral.glsl?raw'
import shBasis from './shaders/chunks/sh_basis.glsl?raw'
import shadow from './shaders/chunks/shadow.glsl?raw'
import shadowCone from './shaders/chunks/shadow_cone.glsl?raw'
import shadowWindow from './shaders/chunks/shadow_window.glsl?raw'
import surface from './shaders/chunks/surface.glsl?raw'
import tileSurfaces from './shaders/chunks/tile_surfaces.glsl?raw'
import valData from './shaders/chunks/val_data.glsl?raw'
import composite from './shaders/composite.frag?raw'
import copy from './shaders/copy.frag?raw'
import coverageFragment from './shaders/coverage.frag?raw'
import coverageVertex from './shaders/coverage.vert?raw'
import display from './shaders/display.frag?raw'
import gather from './shaders/gather.frag?raw'
import gbufferObjectFragment from './shaders/gbuffer_object.frag?raw'
import gbufferObjectVertex from './shaders/gbuffer_object.vert?raw'
import gbufferRoomFragment from './shaders/gbuffer_room.frag?raw'
import gbufferRoomVertex from './shaders/gbuffer_room.vert?raw'
import resolve from './shaders/resolve.frag?raw'
import roomFragment from './shaders/room.frag?raw'
import roomVertex from './shaders/room.vert?raw'
import screen from './shaders/screen.vert?raw'
import shade from './shaders/shade.frag?raw'
import shadowMapFragment from './shaders/shadow_map.frag?raw'
import shadowMapVertex from './shaders/shadow_map.vert?raw'
import tileVertex from './shaders/tile.vert?raw'
import tileEdgesVertex from './shaders/tile_edges.vert?raw'
import tiles from './shaders/tiles.frag?raw'
import valMarkerFragment from './shaders/val_marker.frag?raw'
import valMarkerVertex from './shaders/val_marker.vert?raw'

const CHUNKS: Readonly<Record<string, string>> = {
  bits,
  composite: compositeChunk,
  indirect_exchange: indirectExchange,
  object_data: objectData,
  octahedral,
  sh_basis: shBasis,
  shadow,
  shadow_cone: shadowCone,
  shadow_window: shadowWindow,
  surface,
  tile_surfaces: tileSurfaces,
  val_data: valData,
}

const INCLUDE = /^#include <(\w+)>$/gm

/** Replaces include lines by their chunks. */
export function resolveIncludes(source: string): string {
  return source.replace(INCLUDE, (line, name: string) => {
    const chunk = CHUNKS[name]
    if (chunk === undefined) {
      throw new Error(`${line}: no such chunk; known are ${Object.keys(CHUNKS).join(', ')}`)
    }
    return chunk
  })
}

export interface ShaderSource {
  readonly vertex: string
  readonly fragment: string
}

/** The fragment stage with `#define`s after its version. */
function stages(vertex: string, fragment: string, defines: readonly string[] = []): ShaderSource {
  const version = fragment.indexOf('\n') + 1
  const lines = defines.map((name) => `#define ${name}\n`).join('')
  return { vertex, fragment: fragment.slice(0, version) + lines + resolveIncludes(fragment.slice(version)) }
}

const screenPass = (fragment: string, defines: readonly string[] = []): ShaderSource =>
  stages(screen, fragment, defines)

/** Vertex and fragment stage of every program. */
export const SHADERS = {
  background: screenPass(background),
  backgroundSameSize: screenPass(background, ['SAME_SIZE']),
  room: { vertex: roomVertex, fragment: roomFragment },
  gbufferRoom: { vertex: gbufferRoomVertex, fragment: resolveIncludes(gbufferRoomFragment) },
  gbufferObject: { vertex: gbufferObjectVertex, fragment: resolveIncludes(gbufferObjectFragment) },
  shadowMap: { vertex: shadowMapVertex, fragment: shadowMapFragment },
  tiles: screenPass(tiles),
  shade: screenPass(shade, ['LIGHTS', 'OBJECTS']),
  shadeReceiverRatio: screenPass(shade, ['LIGHTS', 'OBJECTS', 'RECEIVER_RATIO']),
  shadeExchangeOnly: stages(tileVertex, shade),
  shadeReal: stages(tileVertex, shade, ['LIGHTS']),
  shadeMixed: stages(tileVertex, shade, ['LIGHTS', 'OBJECTS']),
  interleaveReal: stages(tileVertex, shade, ['LIGHTS', 'INTERLEAVED']),
  interleaveMixed: stages(tileVertex, shade, ['LIGHTS', 'OBJECTS', 'INTERLEAVED']),
  interleaveExchangeOnly: stages(tileVertex, shade, ['INTERLEAVED']),
  gather: stages(tileVertex, gather),
  coverage: { vertex: coverageVertex, fragment: coverageFragment },
  resolve: screenPass(resolve),
  resolveTiles: stages(tileEdgesVertex, resolve),
  copy: screenPass(copy),
  copyTiles: stages(tileEdgesVertex, copy),
  composite: screenPass(composite),
  display: screenPass(display),
  displayOutlined: screenPass(display, ['OUTLINE']),
  valMarker: { vertex: resolveIncludes(valMarkerVertex), fragment: valMarkerFragment },
} as const

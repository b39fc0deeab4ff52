/** The shader files, with `#include <chunk>` resolved. */
import background from './shaders/background.frag?raw'
import indirectExchange from './shaders/chunks/indirect_exchange.glsl?raw'
import objectData from './shaders/chunks/object_data.glsl?raw'
import octahedral from './shaders/chunks/octahedral.glsl?raw'
import shBasis from './shaders/chunks/sh_basis.glsl?raw'
import shadow from './shaders/chunks/shadow.glsl?raw'
import shadowCone from './shaders/chunks/shadow_cone.glsl?raw'
import surface from './shaders/chunks/surface.glsl?raw'
import valData from './shaders/chunks/val_data.glsl?raw'
import coverageFragment from './shaders/coverage.frag?raw'
import coverageVertex from './shaders/coverage.vert?raw'
import display from './shaders/display.frag?raw'
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
import tiles from './shaders/tiles.frag?raw'
import valMarkerFragment from './shaders/val_marker.frag?raw'
import valMarkerVertex from './shaders/val_marker.vert?raw'

const CHUNKS: Readonly<Record<string, string>> = {
  indirect_exchange: indirectExchange,
  object_data: objectData,
  octahedral,
  sh_basis: shBasis,
  shadow,
  shadow_cone: shadowCone,
  surface,
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

const screenPass = (fragment: string): { vertex: string; fragment: string } => ({
  vertex: screen,
  fragment: resolveIncludes(fragment),
})

/** Vertex and fragment stage of every program. */
export const SHADERS = {
  background: screenPass(background),
  room: { vertex: roomVertex, fragment: roomFragment },
  gbufferRoom: { vertex: gbufferRoomVertex, fragment: resolveIncludes(gbufferRoomFragment) },
  gbufferObject: { vertex: gbufferObjectVertex, fragment: resolveIncludes(gbufferObjectFragment) },
  shadowMap: { vertex: shadowMapVertex, fragment: shadowMapFragment },
  tiles: screenPass(tiles),
  shade: screenPass(shade),
  coverage: { vertex: coverageVertex, fragment: coverageFragment },
  resolve: screenPass(resolve),
  display: screenPass(display),
  valMarker: { vertex: resolveIncludes(valMarkerVertex), fragment: valMarkerFragment },
} as const

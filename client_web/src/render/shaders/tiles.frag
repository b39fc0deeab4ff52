#version 300 es
precision highp float;
precision highp int;
// One fragment per 8x8 tile: which VALs can matter there, and what kind of tile it is.
#include <octahedral>
#include <surface>
#include <val_data>
#include <object_data>
#include <shadow_cone>
#include <tile_surfaces>
uniform ivec2 uSize;
uniform int uNumVals;
uniform bool uShadows;
// Radiance that may be left out of a tile, in all.
uniform float uBudget;
// Bits of VALs in x and y, kind of the tile in z.
layout(location = 0) out uvec4 oLights;

const uint EMPTY = 0u;
const uint EXCHANGE_ONLY = 1u;
const uint REAL = 2u;
const uint MIXED = 3u;

bool inAnyField(TileSurfaces tile) {
  for (int object = 0; object < uNumObjects; object++) {
    vec4 world = vec4(tile.centreWorld, 1.0);
    vec3 centre = vec3(dot(objectRow(object, 18), world), dot(objectRow(object, 19), world), dot(objectRow(object, 20), world));
    vec3 halfSize = 0.5 * objectRow(object, 22).xyz;
    vec3 beyond = abs(centre - objectRow(object, 21).xyz - halfSize) - halfSize;
    if (max(beyond.x, max(beyond.y, beyond.z)) < tile.radius) {
      return true;
    }
  }
  return false;
}

// Upper bound of the radiance that any surface of the tile reflects of an unoccluded VAL: disc form of protocol/CONVENTIONS.md.
float mostReflected(Val val, TileSurfaces tile) {
  float intensity = max(val.radiantIntensity.r, max(val.radiantIntensity.g, val.radiantIntensity.b));
  vec3 toVal = val.positionWorld - tile.centreWorld;
  float apart = length(toVal);
  float nearest = max(apart - tile.radius, 1e-6);
  // Greatest cosine between a normal of the cone and the direction of the VAL.
  float cosine = dot(tile.normalAxis, toVal) / max(apart, 1e-6);
  float sine = sqrt(max(1.0 - cosine * cosine, 0.0));
  float towards = cosine >= tile.normalCone.x ? 1.0 : dot(vec2(cosine, sine), tile.normalCone);
  float received = clamp((apart * towards + tile.radius) / nearest, 0.0, 1.0);
  float emitted = clamp((tile.radius - dot(toVal, val.normalWorld)) / nearest, 0.0, 1.0);
  return tile.mostAlbedo * 0.3183099 * intensity * received * emitted / (nearest * nearest + val.area * 0.3183099);
}

void main() {
  ivec2 first = ivec2(gl_FragCoord.xy) * TILE;
  TileSurfaces tile = fetchTile(first, min(first + TILE, uSize));
  oLights = uvec4(0u);
  if (!tile.anyReal && !tile.anyVirtual) {
    return;
  }
  float left = uBudget;
  for (int slot = 0; slot < uNumVals; slot++) {
    Val val = fetchVal(slot);
    float most = mostReflected(val, tile);
    bool matters = most > 0.0 &&
      (tile.anyVirtual || (uShadows && val.hasShadowMap && ballInShadowCone(val, tile.centreWorld, tile.radius)));
    if (matters && most <= left) {
      left -= most;
      matters = false;
    }
    if (matters) {
      uint bit = 1u << uint(slot & 31);
      oLights.xy |= slot < 32 ? uvec2(bit, 0u) : uvec2(0u, bit);
    }
  }
  bool hasLight = (oLights.x | oLights.y) != 0u;
  oLights.z = tile.anyVirtual ? MIXED : hasLight ? REAL : inAnyField(tile) ? EXCHANGE_ONLY : EMPTY;
}

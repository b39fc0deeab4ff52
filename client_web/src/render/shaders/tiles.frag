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
    float intensity = max(val.radiantIntensity.r, max(val.radiantIntensity.g, val.radiantIntensity.b));
    vec3 toVal = val.positionWorld - tile.centreWorld;
    float apart = length(toVal);
    float angle = acos(clamp(dot(tile.normalAxis, toVal) / max(apart, 1e-6), -1.0, 1.0));
    float slack = tile.normalAngle + (tile.radius < apart ? asin(tile.radius / apart) : 3.1415927);
    bool turnedAway = intensity <= 0.0 || angle - slack > 1.5709 || dot(toVal, val.normalWorld) > tile.radius;
    bool matters = !turnedAway && (tile.anyVirtual || (uShadows && val.hasShadowMap && ballInShadowCone(val, tile.centreWorld, tile.radius)));
    // Upper bound of the reflected radiance: disc form of protocol/CONVENTIONS.md.
    float nearest = max(apart - tile.radius, 0.0);
    float most = tile.mostAlbedo * 0.3183099 * intensity / max(nearest * nearest + val.area * 0.3183099, 1e-9);
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

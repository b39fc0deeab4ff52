#version 300 es
precision highp float;
precision highp int;
// One fragment per 8x8 tile: a bit for each VAL that can matter there.
#include <octahedral>
#include <surface>
#include <val_data>
#include <object_data>
#include <shadow_cone>
uniform ivec2 uSize;
uniform int uNumVals;
layout(location = 0) out uvec4 oMask;

const int TILE = 8;

void main() {
  ivec2 first = ivec2(gl_FragCoord.xy) * TILE;
  ivec2 end = min(first + TILE, uSize);
  float nearest = 1.0;
  float farthest = 0.0;
  bool anyReal = false;
  bool anyVirtual = false;
  for (int y = first.y; y < end.y; y++) {
    for (int x = first.x; x < end.x; x++) {
      float depth = texelFetch(uDepth, ivec2(x, y), 0).r;
      if (depth < 1.0) {
        bool isVirtual = texelFetch(uAlbedo, ivec2(x, y), 0).a > 0.5;
        anyVirtual = anyVirtual || isVirtual;
        anyReal = anyReal || !isVirtual;
        nearest = min(nearest, depth);
        farthest = max(farthest, depth);
      }
    }
  }
  oMask = uvec4(0u);
  uvec2 mask = uvec2(0u);
  if (!anyReal && !anyVirtual) {
    return;
  }
  // Ball around the frustum piece that holds all surfaces of the tile.
  float z0 = distanceFromDepth(nearest);
  float z1 = distanceFromDepth(farthest);
  vec2 low = vec2(first) - 0.5;
  vec2 high = vec2(end) - 0.5;
  vec3 centre = 0.5 * (cameraPoint(0.5 * (low + high), z0) + cameraPoint(0.5 * (low + high), z1));
  float radius = 0.0;
  for (int corner = 0; corner < 8; corner++) {
    vec2 at = vec2((corner & 1) == 0 ? low.x : high.x, (corner & 2) == 0 ? low.y : high.y);
    radius = max(radius, distance(centre, cameraPoint(at, (corner & 4) == 0 ? z0 : z1)));
  }
  vec3 centreWorld = (uWorldFromCamera * vec4(centre, 1.0)).xyz;
  // Covers rounding of the positions that the shading pass computes itself.
  radius = radius * 1.001 + 1e-4;
  for (int slot = 0; slot < uNumVals; slot++) {
    Val val = fetchVal(slot);
    bool dark = max(val.radiantIntensity.r, max(val.radiantIntensity.g, val.radiantIntensity.b)) <= 0.0;
    bool behind = dot(centreWorld - val.positionWorld, val.normalWorld) < -radius;
    if (!dark && !behind && (anyVirtual || ballInShadowCone(val, centreWorld, radius))) {
      uint bit = 1u << uint(slot & 31);
      mask |= slot < 32 ? uvec2(bit, 0u) : uvec2(0u, bit);
    }
  }
  oMask = uvec4(mask, 0u, 0u);
}

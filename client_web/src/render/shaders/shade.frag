#version 300 es
precision highp float;
precision highp int;
precision highp sampler3D;
precision highp sampler2DShadow;
// What virtual objects change in the picture: Rohmer et al. 2014, Eq. 12 and 13. Virtual fragments: their radiance, alpha 1; real
// fragments: the change of their radiance, alpha 0. The background is added later, so it may change alone.
// LIGHTS: the tile has VALs. OBJECTS: it has virtual fragments. INTERLEAVED: of the tile's VALs, and of the objects that exchange light with
// a surface, each fragment of a square of 2 x 2 takes every fourth, and gather.frag adds them up (Keller and Heidrich 2001; Segovia et al.
// 2006). RECEIVER_RATIO: real surfaces are scaled.
#include <octahedral>
#include <sh_basis>
#include <surface>
#include <val_data>
#include <object_data>
#include <shadow_cone>
#include <shadow_window>
#include <shadow>
#include <indirect_exchange>
#include <bits>
uniform highp sampler2D uIndirect;
#ifdef RECEIVER_RATIO
uniform highp sampler2D uBackground;
#endif
uniform highp usampler2D uTileLights;
uniform bool uTiled;
uniform int uNumVals;
uniform bool uShadows;
uniform bool uIndirectExchange;
uniform bool uFixtureRays;
uniform bool uRoomShadows;
// 0 composite, 1 the room alone lit by VALs, 2 the augmented room lit by VALs (oracles of the tests).
uniform int uMode;
layout(location = 0) out vec4 oChange;
#ifdef INTERLEAVED
// Radiance per unit albedo that this fragment's share of VALs and objects changes; in alpha its distance from the camera, negative for
// virtual fragments.
layout(location = 1) out vec4 oShare;
// Radiance below which half of the taps do.
uniform float uFaint;

const int FRAGMENTS = 4;

int fragmentInSquare(ivec2 at) {
  return (at.x & 1) + 2 * (at.y & 1);
}
#endif

#ifdef LIGHTS
// Radiance per unit albedo that a VAL adds to (virtual) or that virtual objects take from (real) this surface.
vec3 shadeWithVal(int slot, Surface surface, mat2 rotation) {
  Val val = fetchVal(slot);
  vec3 irradiance = valIrradiance(val, surface.positionWorld, surface.normalWorld);
  bool lit = max(irradiance.r, max(irradiance.g, irradiance.b)) > 0.0;
  vec3 radiance = 0.3183098861837907 * irradiance;
  bool isReal = true;
#ifdef OBJECTS
  isReal = surface.kind == 0;
#endif
  if (uShadows && uFixtureRays) {
    radiance *= isReal ? val.openShare : openShareOf(slot, surface.kind - 1);
  }
  bool mapped = lit && uShadows && val.hasShadowMap;
#ifdef INTERLEAVED
  const bool inCone = true;
#else
  bool inCone = !isReal || ballInShadowCone(val, surface.positionWorld, 0.0);
#endif
  Receiver receiver = makeReceiver(val, slot, surface.positionWorld, surface.normalWorld, rotation);
#ifdef INTERLEAVED
  // The noise of fewer taps weighs little where the VAL does.
  float effort = max(radiance.r, max(radiance.g, radiance.b)) > uFaint ? 1.0 : 0.5;
#else
  const float effort = 1.0;
#endif
  float amongObjects = virtualVisibility(receiver, val, mapped && inCone ? effort : 0.0);
  bool needsRoom = !isReal || uMode != 0 ? amongObjects > 0.0 || uMode == 1 : amongObjects < 1.0;
  float inRoom = roomVisibility(receiver, val, uRoomShadows && mapped && needsRoom ? effort : 0.0);
  if (!isReal) {
    return radiance * (inRoom * amongObjects);
  }
  if (uMode == 0) {
    return radiance * (inRoom * (1.0 - amongObjects));
  }
  return radiance * (uMode == 1 ? inRoom : inRoom * amongObjects);
}

vec3 shadeWithVals(ivec2 at, Surface surface) {
#ifdef INTERLEAVED
  // Fragments with the same share of the VALs are two apart, and their taps should differ.
  mat2 rotation = tapRotation(vec2(at / 2));
#else
  mat2 rotation = tapRotation(vec2(at));
#endif
  uvec2 lights = uvec2(0xffffffffu);
  if (uTiled) {
    lights = texelFetch(uTileLights, at / 8, 0).xy;
  }
  lights.x &= uNumVals >= 32 ? 0xffffffffu : (1u << uint(uNumVals)) - 1u;
  lights.y &= uNumVals >= 64 ? 0xffffffffu : uNumVals <= 32 ? 0u : (1u << uint(uNumVals - 32)) - 1u;
  vec3 sum = vec3(0.0);
#ifdef INTERLEAVED
  // By slot, so that tiles with other VALs share them out alike.
  lights &= uvec2(0x11111111u << uint(fragmentInSquare(at)));
#endif
  while (lights.x != 0u || lights.y != 0u) {
    bool inFirst = lights.x != 0u;
    uint bit = lowestBit(inFirst ? lights.x : lights.y);
    lights ^= inFirst ? uvec2(bit, 0u) : uvec2(0u, bit);
    sum += shadeWithVal(bitIndex(bit) + (inFirst ? 0 : 32), surface, rotation);
  }
  return sum;
}
#endif

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  Surface surface = fetchSurface(at);
  vec3 fromVals = vec3(0.0);
#ifdef LIGHTS
  if (surface.kind >= 0) {
    fromVals = shadeWithVals(at, surface);
  }
#endif
  vec3 exchanged = vec3(0.0);
  if (uIndirectExchange && uMode == 0) {
#ifdef INTERLEAVED
    int first = fragmentInSquare(at);
    const int step = FRAGMENTS;
#else
    const int first = 0;
    const int step = 1;
#endif
    for (int object = first; object < uNumObjects; object += step) {
      if (object + 1 != surface.kind) {
        exchanged += exchangedIrradiance(object, surface.positionWorld, surface.normalWorld);
      }
    }
    exchanged *= 0.3183098861837907;
  }
#ifdef INTERLEAVED
  float away = length(surface.positionWorld - uWorldFromCamera[3].xyz);
  // Kept in half floats, which end at 65504.
  oShare = vec4(clamp(surface.kind > 0 ? exchanged + fromVals : exchanged - fromVals, -65000.0, 65000.0), surface.kind > 0 ? -away : away);
  fromVals = vec3(0.0);
  exchanged = vec3(0.0);
#endif
  fromVals *= surface.albedo;
  exchanged *= surface.albedo;
  oChange = vec4(uMode == 0 ? exchanged - fromVals : fromVals, 0.0);
#ifdef RECEIVER_RATIO
  vec3 ratio = vec3(1.0);
  for (int object = 0; object < uNumObjects && uMode == 0; object++) {
    ratio *= receiverRatio(object, surface.positionWorld, surface.normalWorld);
  }
  oChange.rgb += texelFetch(uBackground, at, 0).rgb * (ratio - 1.0);
#endif
#ifdef OBJECTS
  if (surface.kind > 0) {
    oChange = vec4(max(texelFetch(uIndirect, at, 0).rgb + exchanged, 0.0) + fromVals, 1.0);
  }
#endif
  if (surface.kind < 0) {
    oChange = vec4(0.0);
  }
}

#version 300 es
precision highp float;
precision highp int;
precision highp sampler3D;
precision highp sampler2DShadow;
#include <octahedral>
#include <sh_basis>
#include <surface>
#include <val_data>
#include <object_data>
#include <shadow_cone>
#include <shadow>
#include <indirect_exchange>
uniform highp sampler2D uIndirect;
uniform highp sampler2D uBackground;
uniform highp usampler2D uTileMask;
uniform bool uTiled;
uniform int uNumVals;
uniform bool uShadows;
uniform bool uIndirectExchange;
uniform bool uFixtureRays;
uniform bool uRoomShadows;
uniform bool uReceiverRatio;
// 0 composite, 1 the room alone lit by VALs, 2 the augmented room lit by VALs (oracles of the tests).
uniform int uMode;
layout(location = 0) out vec4 oRadiance;

float seenThroughRoom(Receiver receiver, Val val) {
  return uRoomShadows ? roomVisibility(receiver, val) : 1.0;
}

// Radiance that the VALs add to (virtual) or that virtual objects take from (real) this surface: Rohmer et al. 2014, Eq. 12 and 13.
vec3 shadeWithVal(int slot, Surface surface, float turn) {
  Val val = fetchVal(slot);
  bool isReal = surface.kind == 0;
  vec3 irradiance = valIrradiance(val, surface.positionWorld, surface.normalWorld);
  if (max(irradiance.r, max(irradiance.g, irradiance.b)) <= 0.0) {
    return vec3(0.0);
  }
  vec3 radiance = surface.albedo * 0.3183098861837907 * irradiance;
  if (uShadows && uFixtureRays) {
    radiance *= isReal ? val.openShare : openShareOf(slot, surface.kind - 1);
  }
  bool mapped = uShadows && val.hasShadowMap;
  Receiver receiver = makeReceiver(val, slot, surface.positionWorld, surface.normalWorld, turn);
  if (!isReal) {
    return mapped ? radiance * (seenThroughRoom(receiver, val) * virtualVisibility(receiver, val)) : radiance;
  }
  float behindVirtual = mapped && ballInShadowCone(val, surface.positionWorld, 0.0) ? virtualVisibility(receiver, val) : 1.0;
  if (uMode == 0) {
    return behindVirtual < 1.0 ? radiance * (seenThroughRoom(receiver, val) * (1.0 - behindVirtual)) : vec3(0.0);
  }
  float seen = mapped ? seenThroughRoom(receiver, val) : 1.0;
  return radiance * (uMode == 1 ? seen : seen * behindVirtual);
}

vec3 shadeWithVals(ivec2 at, Surface surface) {
  float turn = 6.283185307179586 * interleavedNoise(vec2(at));
  uvec2 mask = uvec2(0xffffffffu);
  if (uTiled) {
    mask = texelFetch(uTileMask, at / 8, 0).xy;
  }
  mask.x &= uNumVals >= 32 ? 0xffffffffu : (1u << uint(uNumVals)) - 1u;
  mask.y &= uNumVals >= 64 ? 0xffffffffu : uNumVals <= 32 ? 0u : (1u << uint(uNumVals - 32)) - 1u;
  vec3 sum = vec3(0.0);
  for (int word = 0; word < 2; word++) {
    uint bits = word == 0 ? mask.x : mask.y;
    while (bits != 0u) {
      uint lowest = bits & (~bits + 1u);
      int slot = int(floatBitsToUint(float(lowest)) >> 23) - 127;
      bits ^= lowest;
      sum += shadeWithVal(32 * word + slot, surface, turn);
    }
  }
  return sum;
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  Surface surface = fetchSurface(at);
  vec3 background = texelFetch(uBackground, at, 0).rgb;
  if (surface.kind < 0) {
    oRadiance = vec4(background, 0.0);
    return;
  }
  vec3 fromVals = shadeWithVals(at, surface);
  vec3 exchanged = vec3(0.0);
  if (uIndirectExchange && uMode == 0) {
    for (int object = 0; object < uNumObjects; object++) {
      if (object + 1 != surface.kind) {
        exchanged += exchangedIrradiance(object, surface.positionWorld, surface.normalWorld);
      }
    }
    exchanged *= surface.albedo * 0.3183098861837907;
  }
  if (uReceiverRatio && surface.kind == 0) {
    for (int object = 0; object < uNumObjects; object++) {
      background *= receiverRatio(object, surface.positionWorld, surface.normalWorld);
    }
  }
  vec3 radiance;
  if (surface.kind > 0) {
    radiance = max(texelFetch(uIndirect, at, 0).rgb + exchanged, 0.0) + fromVals;
  } else if (uMode == 0) {
    radiance = background - fromVals + exchanged;
  } else {
    radiance = fromVals;
  }
  // A real fragment can fall below zero where the modelled albedo or visibility is too high.
  oRadiance = vec4(max(radiance, 0.0), surface.kind > 0 ? 1.0 : 0.0);
}

#version 300 es
precision highp float;
precision highp int;
// Adds up what the fragments of each square of 2 x 2 found with their share of VALs and objects: each share is the mean of its nearest
// fragments on the same surface, so it is exact where light and visibility change linearly.
uniform highp sampler2D uChange;
uniform highp sampler2D uShare;
uniform highp sampler2D uAlbedo;
layout(location = 0) out vec4 oChange;

// Distances that differ by more than this share belong to different surfaces.
const float SAME_SURFACE = 0.02;

vec4 weighed(ivec2 at, ivec2 last, float distance) {
  vec4 value = texelFetch(uShare, clamp(at, ivec2(0), last), 0);
  // Where no fragment of a share lies on the same surface, one of the same kind has to do.
  float weight = abs(value.a - distance) <= SAME_SURFACE * abs(distance) ? 1.0 : value.a * distance > 0.0 ? 1e-3 : 0.0;
  return vec4(value.rgb * weight, weight);
}

vec3 meanOr(vec4 weighedSum, vec3 own) {
  return weighedSum.a > 0.0 ? weighedSum.rgb / weighedSum.a : own;
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  ivec2 last = textureSize(uShare, 0) - 1;
  vec4 own = texelFetch(uShare, at, 0);
  vec4 beside = weighed(at + ivec2(-1, 0), last, own.a) + weighed(at + ivec2(1, 0), last, own.a);
  vec4 above = weighed(at + ivec2(0, -1), last, own.a) + weighed(at + ivec2(0, 1), last, own.a);
  vec4 across = weighed(at + ivec2(-1, -1), last, own.a) + weighed(at + ivec2(1, -1), last, own.a) +
    weighed(at + ivec2(-1, 1), last, own.a) + weighed(at + ivec2(1, 1), last, own.a);
  vec3 share = own.rgb + meanOr(beside, own.rgb) + meanOr(above, own.rgb) + meanOr(across, own.rgb);
  vec4 change = texelFetch(uChange, at, 0);
  vec3 radiance = change.rgb + texelFetch(uAlbedo, at, 0).rgb * share;
  oChange = vec4(change.a > 0.5 ? max(radiance, 0.0) : radiance, change.a);
}

// Radiance of the augmented picture. A real fragment can fall below zero where the modelled albedo or visibility is too high.
uniform highp sampler2D uBackground;
uniform highp sampler2D uChange;
// 0 leaves the background out (oracles of the tests).
uniform float uBackgroundShare;

vec4 compositeAt(ivec2 at) {
  vec4 change = texelFetch(uChange, at, 0);
  vec3 background = texelFetch(uBackground, at, 0).rgb;
  return vec4(max(uBackgroundShare * (1.0 - change.a) * background + change.rgb, 0.0), change.a);
}

#version 300 es
precision highp float;
precision highp int;
// Blends real and virtual radiance at silhouettes by the multisampled coverage of the virtual objects.
uniform highp sampler2D uComposite;
uniform highp sampler2D uCoverageMap;
uniform highp sampler2D uBackground;
layout(location = 0) out vec4 oRadiance;

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  ivec2 last = textureSize(uComposite, 0) - 1;
  vec4 own = texelFetch(uComposite, at, 0);
  float coverage = texelFetch(uCoverageMap, at, 0).r;
  if (abs(coverage - own.a) < 1e-3) {
    oRadiance = vec4(own.rgb, coverage);
    return;
  }
  // Mean of the neighbours of the other kind; of real ones only their change against the background.
  vec3 sum = vec3(0.0);
  float weight = 0.0;
  for (int y = -1; y <= 1; y++) {
    for (int x = -1; x <= 1; x++) {
      ivec2 near = clamp(at + ivec2(x, y), ivec2(0), last);
      vec4 value = texelFetch(uComposite, near, 0);
      if (abs(value.a - own.a) > 0.5) {
        float share = x == 0 || y == 0 ? 1.0 : 0.5;
        bool change = own.a > 0.5;
        sum += share * (change ? value.rgb - texelFetch(uBackground, near, 0).rgb : value.rgb);
        weight += share;
      }
    }
  }
  vec3 other = own.rgb;
  if (own.a > 0.5) {
    other = max(texelFetch(uBackground, at, 0).rgb + (weight > 0.0 ? sum / weight : vec3(0.0)), 0.0);
  } else if (weight > 0.0) {
    other = sum / weight;
  }
  float ownShare = own.a > 0.5 ? coverage : 1.0 - coverage;
  oRadiance = vec4(mix(other, own.rgb, ownShare), coverage);
}

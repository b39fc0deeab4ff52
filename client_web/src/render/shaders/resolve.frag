#version 300 es
precision highp float;
precision highp int;
// Blends real and virtual fragments at silhouettes by the multisampled coverage of the virtual objects: premultiplied radiance, with
// the change of what remains of the background.
uniform highp sampler2D uChange;
uniform highp sampler2D uCoverageMap;
layout(location = 0) out vec4 oChange;

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  ivec2 last = textureSize(uChange, 0) - 1;
  vec4 own = texelFetch(uChange, at, 0);
  float coverage = texelFetch(uCoverageMap, at, 0).r;
  // Mean of the neighbours of the other kind.
  vec3 sum = vec3(0.0);
  float weight = 0.0;
  for (int y = -1; y <= 1; y++) {
    for (int x = -1; x <= 1; x++) {
      vec4 value = texelFetch(uChange, clamp(at + ivec2(x, y), ivec2(0), last), 0);
      float share = abs(value.a - own.a) <= 0.5 ? 0.0 : x == 0 || y == 0 ? 1.0 : 0.5;
      sum += share * value.rgb;
      weight += share;
    }
  }
  bool isVirtual = own.a > 0.5;
  // A real neighbour that does not exist changes nothing; a virtual one leaves the fragment as it is.
  vec3 other = weight > 0.0 ? sum / weight : vec3(0.0);
  coverage = weight > 0.0 || isVirtual ? coverage : 0.0;
  oChange = abs(coverage - own.a) < 1e-3 ? own : vec4(mix(isVirtual ? other : own.rgb, isVirtual ? own.rgb : other, coverage), coverage);
}

#version 300 es
precision highp float;
precision highp int;
// Exposure and sRGB transfer function (IEC 61966-2-1).
uniform highp sampler2D uComposite;
uniform float uExposure;
uniform bool uSoftClip;
layout(location = 0) out vec4 oDisplay;

// Identity up to 0.8, then bends towards 1 with a continuous slope, so bright lamps keep some shape.
vec3 softClip(vec3 v) {
  vec3 over = max(v - 0.8, 0.0);
  return min(v, 0.8) + 0.2 * (1.0 - exp(-over / 0.2));
}

void main() {
  vec3 v = texelFetch(uComposite, ivec2(gl_FragCoord.xy), 0).rgb * uExposure;
  v = clamp(uSoftClip ? softClip(v) : v, 0.0, 1.0);
  vec3 low = 12.92 * v;
  vec3 high = 1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055;
  oDisplay = vec4(mix(high, low, vec3(lessThanEqual(v, vec3(0.0031308)))), 1.0);
}

#version 300 es
precision highp float;
precision highp int;
// Least and greatest inverse depth of squares of 4 x 4.
// FROM_DEPTH: of a shadow map itself, else of bounds.
uniform highp sampler2D uSource;
uniform float uShadowNear;
layout(location = 0) out vec2 oBounds;

void main() {
  ivec2 first = ivec2(gl_FragCoord.xy) * 4;
  vec2 bounds = vec2(1e30, 0.0);
  for (int i = 0; i < 16; i++) {
    vec2 value = texelFetch(uSource, first + ivec2(i & 3, i >> 2), 0).rg;
#ifdef FROM_DEPTH
    // Half floats round; bounds stay bounds.
    value = (1.0 - value.r) / uShadowNear * vec2(0.999, 1.001);
#endif
    bounds = vec2(min(bounds.x, value.x), max(bounds.y, value.y));
  }
  oBounds = bounds;
}

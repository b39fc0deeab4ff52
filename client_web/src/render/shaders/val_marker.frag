#version 300 es
precision highp float;
precision highp int;
// Hidden markers show through faintly.
uniform highp sampler2D uDepth;
uniform float uNear;
in vec3 vTint;
in float vDistance;
layout(location = 0) out vec4 oDisplay;

void main() {
  float depth = texelFetch(uDepth, ivec2(gl_FragCoord.xy), 0).r;
  float surface = uNear / max(1.0 - depth, 1e-7);
  float opacity = vDistance <= surface * 1.01 + 0.01 ? 0.9 : 0.25;
  oDisplay = vec4(vTint * opacity, opacity);
}

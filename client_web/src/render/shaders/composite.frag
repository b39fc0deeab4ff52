#version 300 es
precision highp float;
precision highp int;
// Linear radiance, to be read back.
#include <composite>
layout(location = 0) out vec4 oRadiance;

void main() {
  oRadiance = compositeAt(ivec2(gl_FragCoord.xy));
}

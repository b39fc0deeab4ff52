#version 300 es
precision highp float;
precision highp int;
#include <octahedral>
in vec3 vNormal;
in vec3 vAlbedo;
layout(location = 0) out vec4 oAlbedo;
layout(location = 1) out uvec2 oNormal;
layout(location = 2) out vec4 oRadiance;

void main() {
  oAlbedo = vec4(vAlbedo, 0.0);
  oNormal = encodeOctahedral(normalize(vNormal));
  oRadiance = vec4(0.0);
}

#version 300 es
precision highp float;
precision highp int;
#include <octahedral>
uniform vec3 uAlbedoOfObject;
uniform float uKind;
in vec3 vNormal;
in vec3 vRadiance;
layout(location = 0) out vec4 oAlbedo;
layout(location = 1) out uvec2 oNormal;
layout(location = 2) out vec4 oRadiance;

void main() {
  oAlbedo = vec4(uAlbedoOfObject, uKind);
  oNormal = encodeOctahedral(normalize(vNormal));
  oRadiance = vec4(vRadiance, 1.0);
}

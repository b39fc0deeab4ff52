#version 300 es
precision highp float;
precision highp int;
#include <octahedral>
// Radiance of the room as the server last measured it (free camera only).
uniform sampler2D uAtlas;
uniform bool uHasAtlas;
in vec3 vNormal;
in vec3 vAlbedo;
in vec2 vUv;
layout(location = 0) out vec4 oAlbedo;
layout(location = 1) out uvec2 oNormal;
layout(location = 2) out vec4 oRadiance;

void main() {
  oAlbedo = vec4(vAlbedo, 0.0);
  oNormal = encodeOctahedral(normalize(vNormal));
  // Row 0 of the atlas is v = 0: no flip.
  oRadiance = vec4(uHasAtlas ? textureLod(uAtlas, vUv, 0.0).rgb : vec3(0.0), 1.0);
}

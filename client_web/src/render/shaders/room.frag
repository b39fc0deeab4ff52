#version 300 es
precision highp float;
// Radiance of the room as the server last measured it. Row 0 of the atlas is v = 0: no flip.
uniform sampler2D uAtlas;
centroid in vec2 vUv;
layout(location = 0) out vec4 oRadiance;

void main() {
  oRadiance = vec4(textureLod(uAtlas, vUv, 0.0).rgb, 1.0);
}

#version 300 es
layout(location = 0) in vec3 aPosition;
layout(location = 3) in vec2 aUv;
uniform mat4 uClipFromWorld;
// At rims a fragment's centre lies outside the triangle, and its texel in the gutter or in another chart.
centroid out vec2 vUv;

void main() {
  vUv = aUv;
  gl_Position = uClipFromWorld * vec4(aPosition, 1.0);
}

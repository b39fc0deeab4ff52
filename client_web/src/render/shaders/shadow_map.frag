#version 300 es
precision highp float;
// Window depth before which nothing casts a shadow.
uniform float uNearestDepth;

void main() {
  if (gl_FragCoord.z < uNearestDepth) {
    discard;
  }
}

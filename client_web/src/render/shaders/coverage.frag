#version 300 es
precision highp float;
uniform float uCoverage;
layout(location = 0) out vec4 oCoverage;
void main() {
  oCoverage = vec4(uCoverage, 0.0, 0.0, 1.0);
}

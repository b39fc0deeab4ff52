#version 300 es
precision highp float;
uniform highp sampler2D uSource;
layout(location = 0) out vec4 oCopy;

void main() {
  oCopy = texelFetch(uSource, ivec2(gl_FragCoord.xy), 0);
}

#version 300 es
precision highp float;
precision highp sampler2DArray;
// SAME_SIZE: pixel by pixel. Background = sum of the basis pictures of a view, one per light (row 0 at the bottom).
uniform sampler2DArray uPictures;
uniform int uNumPictures;
uniform vec3 uWeights[64];
uniform vec2 uTargetSize;
layout(location = 0) out vec4 oRadiance;

void main() {
  vec3 radiance = vec3(0.0);
  for (int k = 0; k < uNumPictures; k++) {
#ifdef SAME_SIZE
    vec3 basis = texelFetch(uPictures, ivec3(ivec2(gl_FragCoord.xy), k), 0).rgb;
#else
    vec3 basis = textureLod(uPictures, vec3(gl_FragCoord.xy / uTargetSize, float(k)), 0.0).rgb;
#endif
    radiance += uWeights[k] * basis;
  }
  oRadiance = vec4(radiance, 1.0);
}

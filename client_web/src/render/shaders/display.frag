#version 300 es
precision highp float;
precision highp int;
// Composite, exposure and sRGB transfer function (IEC 61966-2-1). OUTLINE: around the selected object.
#include <composite>
uniform float uExposure;
uniform bool uSoftClip;
layout(location = 0) out vec4 oDisplay;

// Identity up to 0.8, then bends towards 1 with a continuous slope, so bright lamps keep some shape.
vec3 softClip(vec3 v) {
  vec3 over = max(v - 0.8, 0.0);
  return min(v, 0.8) + 0.2 * (1.0 - exp(-over / 0.2));
}

#ifdef OUTLINE
// Kind of a fragment stands in alpha: 1 + index of its virtual object.
uniform highp sampler2D uAlbedo;
uniform int uSelectedKind;
uniform float uOutlineWidth;

bool isSelected(ivec2 at) {
  ivec2 last = textureSize(uAlbedo, 0) - 1;
  return int(texelFetch(uAlbedo, clamp(at, ivec2(0), last), 0).a + 0.5) == uSelectedKind;
}

// Share of the outline in a fragment: full beside the object, fading over the last fragment of its width.
float outline(ivec2 at) {
  if (isSelected(at)) {
    return 0.0;
  }
  int reach = int(ceil(uOutlineWidth));
  float nearest = uOutlineWidth + 1.0;
  for (int y = -reach; y <= reach; y++) {
    for (int x = -reach; x <= reach; x++) {
      if (isSelected(at + ivec2(x, y))) {
        nearest = min(nearest, length(vec2(x, y)));
      }
    }
  }
  return clamp(uOutlineWidth + 1.0 - nearest, 0.0, 1.0);
}
#endif

void main() {
  vec3 v = compositeAt(ivec2(gl_FragCoord.xy)).rgb * uExposure;
  v = clamp(uSoftClip ? softClip(v) : v, 0.0, 1.0);
  vec3 low = 12.92 * v;
  vec3 high = 1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055;
  vec3 encoded = mix(high, low, vec3(lessThanEqual(v, vec3(0.0031308))));
#ifdef OUTLINE
  encoded = mix(encoded, vec3(1.0), 0.75 * outline(ivec2(gl_FragCoord.xy)));
#endif
  oDisplay = vec4(encoded, 1.0);
}

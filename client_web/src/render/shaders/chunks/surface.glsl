// What the G-buffer knows about one fragment.
uniform highp sampler2D uAlbedo;
uniform highp usampler2D uNormal;
uniform highp sampler2D uDepth;
uniform mat4 uWorldFromCamera;
// fx, fy, cx, cy in fragments, cy counted from the bottom row.
uniform vec4 uLens;
uniform float uNear;

struct Surface {
  vec3 positionWorld;
  vec3 normalWorld;
  vec3 albedo;
  // -1 nothing, 0 real, 1 + index of a virtual object.
  int kind;
};

vec3 cameraPoint(vec2 fragment, float z) {
  return vec3((fragment.x - uLens.z) / uLens.x, -(fragment.y - uLens.w) / uLens.y, 1.0) * z;
}

float distanceFromDepth(float depth) {
  return uNear / max(1.0 - depth, 1e-7);
}

Surface fetchSurface(ivec2 at) {
  Surface surface;
  vec4 albedo = texelFetch(uAlbedo, at, 0);
  float depth = texelFetch(uDepth, at, 0).r;
  surface.kind = depth >= 1.0 ? -1 : int(albedo.a + 0.5);
  surface.albedo = albedo.rgb;
  surface.normalWorld = decodeOctahedral(texelFetch(uNormal, at, 0).rg);
  surface.positionWorld = (uWorldFromCamera * vec4(cameraPoint(vec2(at), distanceFromDepth(depth)), 1.0)).xyz;
  return surface;
}

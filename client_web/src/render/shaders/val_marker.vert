#version 300 es
// Each VAL as its disc (24 triangles) and its normal (one thin triangle).
#include <val_data>
uniform mat4 uClipFromWorld;
out vec3 vTint;
out float vDistance;

void main() {
  Val val = fetchVal(gl_InstanceID);
  vec3 n = val.normalWorld;
  vec3 first = normalize(abs(n.x) < 0.7 ? cross(n, vec3(1.0, 0.0, 0.0)) : cross(n, vec3(0.0, 1.0, 0.0)));
  vec3 second = cross(n, first);
  int triangle = gl_VertexID / 3;
  int corner = gl_VertexID % 3;
  // Large discs stay recognisable as markers.
  float radius = min(val.discRadius, 0.08);
  vec3 p = val.positionWorld + n * 0.003;
  if (triangle < 24) {
    float angle = float(triangle + (corner == 2 ? 1 : 0)) * 0.2617993877991494;
    p += corner == 0 ? vec3(0.0) : radius * (cos(angle) * first + sin(angle) * second);
  } else {
    p += corner == 0 ? 2.0 * radius * n : (corner == 1 ? 0.1 : -0.1) * radius * first;
  }
  float peak = max(val.radiantIntensity.r, max(val.radiantIntensity.g, val.radiantIntensity.b));
  vTint = peak > 0.0 ? val.radiantIntensity / peak : vec3(0.0);
  gl_Position = peak > 0.0 ? uClipFromWorld * vec4(p, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
  vDistance = gl_Position.w;
}

#version 300 es
layout(location = 0) in vec3 aPosition;
uniform mat4 uWorldFromObject;
uniform vec3 uValPosition;
uniform mat3 uMapFromWorld;
// Scale and offset of slopes, as in val_data.
uniform vec4 uWindow;
uniform float uShadowNear;

void main() {
  vec3 p = uMapFromWorld * ((uWorldFromObject * vec4(aPosition, 1.0)).xyz - uValPosition);
  vec2 place = p.xy * uWindow.xy + p.z * uWindow.zw;
  // Far plane at infinity: window depth is 1 - near / z.
  gl_Position = vec4(2.0 * place - p.z, p.z - 2.0 * uShadowNear, p.z);
}

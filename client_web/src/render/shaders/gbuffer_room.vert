#version 300 es
layout(location = 0) in vec3 aPosition;
layout(location = 1) in vec3 aNormal;
layout(location = 2) in vec3 aAlbedo;
uniform mat4 uClipFromWorld;
out vec3 vNormal;
out vec3 vAlbedo;

void main() {
  vNormal = aNormal;
  vAlbedo = aAlbedo;
  gl_Position = uClipFromWorld * vec4(aPosition, 1.0);
}

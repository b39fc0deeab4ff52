#version 430
// One face of a cube map around an object's centre.
in vec3 inPosition;  // metres, around the room's centre
in vec2 inUv;

uniform mat4 uClipFromRoom;

out vec2 vUv;

void main() {
    vUv = inUv;
    gl_Position = uClipFromRoom * vec4(inPosition, 1.0);
}

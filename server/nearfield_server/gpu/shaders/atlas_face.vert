#version 430
// Draws the UV layout: v = 0 is row 0 of the target.
in vec2 inUv;

void main() {
    gl_Position = vec4(2.0 * inUv - 1.0, 0.0, 1.0);
}

#version 430
// Texels that no camera sees repeat the radiance of a texel that some camera sees.
layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Fill { uvec2 fill[]; };  // texel, source
layout(std430, binding = 1) buffer Radiance { float radiance[]; };

uniform uint uNumFill;

void main() {
    uint k = gl_GlobalInvocationID.x;
    if (k >= uNumFill) return;
    for (uint channel = 0u; channel < 3u; ++channel)
        radiance[3u * fill[k].x + channel] = radiance[3u * fill[k].y + channel];
}

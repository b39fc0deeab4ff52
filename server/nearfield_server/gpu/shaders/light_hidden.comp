#version 430
// Texels of hidden surfaces take the radiance that was found for their surface.
layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Hidden { uvec2 hidden[]; };  // texel, surface
layout(std430, binding = 1) readonly buffer Values { float values[]; };  // 3 per surface
layout(std430, binding = 2) buffer Radiance { float radiance[]; };

uniform uint uNumHidden;

void main() {
    uint k = gl_GlobalInvocationID.x;
    if (k >= uNumHidden) return;
    for (uint channel = 0u; channel < 3u; ++channel)
        radiance[3u * hidden[k].x + channel] = values[3u * hidden[k].y + channel];
}

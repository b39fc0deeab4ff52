#version 430
// Histogram of radiance weighted by L dA, in fixed point, over the upper 16 bits of the float. One channel per dispatch.
layout(local_size_x = 256) in;

layout(std430, binding = 0) readonly buffer Radiance { float radiance[]; };
layout(std430, binding = 1) readonly buffer Area { float area[]; };
layout(std430, binding = 2) buffer Histogram { uint histogram[]; };  // 32768

uniform uint uNumTexels;
uniform uint uChannel;
uniform float uScale;  // L dA times this is rounded to an integer; the total stays below 2^32

void main() {
    uint texel = gl_GlobalInvocationID.x;
    if (texel >= uNumTexels) return;
    float value = radiance[3u * texel + uChannel];
    if (value > 0.0) atomicAdd(histogram[floatBitsToUint(value) >> 16], uint(round(value * area[texel] * uScale)));
}

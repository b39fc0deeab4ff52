#version 430
// Inverse cumulative density inside a block: the texel at which the running direct L dA passes `rest`. One sample per thread.
layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Radiance { float radiance[]; };
layout(std430, binding = 1) readonly buffer Area { float area[]; };
layout(std430, binding = 2) readonly buffer Blocks { uint block[]; };
layout(std430, binding = 3) readonly buffer Rest { float rest[]; };
layout(std430, binding = 4) writeonly buffer Chosen { int chosen[]; };

uniform uint uNumTexels;
uniform uint uNumSamples;
uniform float uThreshold[3];

void main() {
    uint sampleIndex = gl_GlobalInvocationID.x;
    if (sampleIndex >= uNumSamples) return;
    uint first = block[sampleIndex] * 64u;
    uint stop = min(first + 64u, uNumTexels);
    float remaining = rest[sampleIndex];
    int result = -1;
    for (uint texel = first; texel < stop; ++texel) {
        float direct = 0.0;
        for (uint channel = 0u; channel < 3u; ++channel) {
            float value = radiance[3u * texel + channel];
            if (value >= uThreshold[channel]) direct += value;
        }
        float weight = direct * area[texel] / 3.0;
        if (weight > 0.0) {
            // Rounding may leave a rest behind the last texel: then the last one with weight is meant.
            result = int(texel);
            if (remaining < weight) break;
            remaining -= weight;
        }
    }
    chosen[sampleIndex] = result;
}

#version 430
// Sum of L dA per channel over texels whose float bits reach each of 16 candidates: one digit of a radix search for the
// exact threshold. Partial sums per work group; the host adds them in float64.
layout(local_size_x = 256) in;

layout(std430, binding = 0) readonly buffer Radiance { float radiance[]; };
layout(std430, binding = 1) readonly buffer Area { float area[]; };
layout(std430, binding = 2) writeonly buffer Partial { float partial[]; };  // groups x 3 x 16

const uint CANDIDATES = 16u;
uniform uint uNumTexels;
uniform uint uPrefix[3];  // bits already known, per channel
uniform uint uShift;      // candidate i is prefix + (i << shift)

shared float sums[256];

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint stride = gl_NumWorkGroups.x * 256u;
    for (uint channel = 0u; channel < 3u; ++channel) {
        // Texels fall into one digit bin each; the sums from above are taken at the end.
        float bins[CANDIDATES];
        for (uint i = 0u; i < CANDIDATES; ++i) bins[i] = 0.0;
        for (uint texel = gl_GlobalInvocationID.x; texel < uNumTexels; texel += stride) {
            float value = radiance[3u * texel + channel];
            uint bits = floatBitsToUint(value);
            if (value > 0.0 && bits >= uPrefix[channel]) {
                uint digit = min((bits - uPrefix[channel]) >> uShift, CANDIDATES - 1u);
                float energy = value * area[texel];
                for (uint i = 0u; i < CANDIDATES; ++i) bins[i] += i == digit ? energy : 0.0;
            }
        }
        for (uint i = 0u; i < CANDIDATES; ++i) {
            sums[lane] = bins[i];
            barrier();
            for (uint half_ = 128u; half_ > 0u; half_ >>= 1) {
                if (lane < half_) sums[lane] += sums[lane + half_];
                barrier();
            }
            if (lane == 0u) partial[(gl_WorkGroupID.x * 3u + channel) * CANDIDATES + i] = sums[0];
            barrier();
        }
    }
}

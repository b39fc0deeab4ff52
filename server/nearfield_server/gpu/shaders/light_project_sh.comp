#version 430
// sh_coeffs of the indirect light around one probe (Rohmer et al. 2014, Eq. 10). One work group per dispatch.
layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Radiance { float radiance[]; };
layout(std430, binding = 1) readonly buffer Probe { int probe[]; };    // texel behind each cube pixel, or -1
layout(std430, binding = 2) readonly buffer Basis { float basis[]; };  // 9 per cube pixel: Y_k times solid angle
layout(std430, binding = 3) writeonly buffer Coefficients { float coefficients[]; };  // 27

uniform uint uNumPixels;
uniform float uThreshold[3];

shared float sums[64];

void main() {
    uint lane = gl_LocalInvocationID.x;
    for (uint channel = 0u; channel < 3u; ++channel) {
        float total[9];
        for (uint k = 0u; k < 9u; ++k) total[k] = 0.0;
        for (uint pixel = lane; pixel < uNumPixels; pixel += 64u) {
            int texel = probe[pixel];
            if (texel < 0) continue;
            float value = radiance[3u * uint(texel) + channel];
            if (value < uThreshold[channel])
                for (uint k = 0u; k < 9u; ++k) total[k] += basis[9u * pixel + k] * value;
        }
        for (uint k = 0u; k < 9u; ++k) {
            sums[lane] = total[k];
            barrier();
            for (uint half_ = 32u; half_ > 0u; half_ >>= 1) {
                if (lane < half_) sums[lane] += sums[lane + half_];
                barrier();
            }
            if (lane == 0u) coefficients[3u * k + channel] = sums[0];
            barrier();
        }
    }
}

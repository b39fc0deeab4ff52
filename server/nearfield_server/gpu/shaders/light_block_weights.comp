#version 430
// Grey direct L dA per block of 64 texels, and the largest radiance of the block. The host sums the blocks in float64.
layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Radiance { float radiance[]; };
layout(std430, binding = 1) readonly buffer Area { float area[]; };
layout(std430, binding = 2) writeonly buffer Blocks { vec4 blocks[]; };  // rgb: maximum, a: grey direct L dA

uniform uint uNumTexels;
uniform float uThreshold[3];

shared vec4 values[64];

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint texel = gl_GlobalInvocationID.x;
    vec4 value = vec4(0.0);
    if (texel < uNumTexels) {
        float direct = 0.0;
        for (uint channel = 0u; channel < 3u; ++channel) {
            float channelRadiance = radiance[3u * texel + channel];
            value[channel] = channelRadiance;
            if (channelRadiance >= uThreshold[channel]) direct += channelRadiance;
        }
        value.a = direct * area[texel] / 3.0;
    }
    values[lane] = value;
    barrier();
    for (uint half_ = 32u; half_ > 0u; half_ >>= 1) {
        if (lane < half_) {
            vec4 other = values[lane + half_];
            values[lane] = vec4(max(values[lane].rgb, other.rgb), values[lane].a + other.a);
        }
        barrier();
    }
    if (lane == 0u) blocks[gl_WorkGroupID.x] = values[0];
}

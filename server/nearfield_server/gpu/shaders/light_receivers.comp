#version 430
// What the receivers of hidden lamps show: their own radiance, and the irradiance on them from everything visible. One work
// group per receiver; only these six numbers go back to the host.
layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Radiance { float radiance[]; };
layout(std430, binding = 1) readonly buffer FirstRays { uint firstRay[]; };    // R + 1
layout(std430, binding = 2) readonly buffer Rays { uvec2 rays[]; };            // texel, bits of the projected solid angle
layout(std430, binding = 3) readonly buffer Patches { uint patches[]; };       // texels around each receiver
layout(std430, binding = 4) writeonly buffer Shown { float shown[]; };         // 6 R: radiance, irradiance

uniform uint uPatchTexels;

shared vec3 sums[64];

vec3 radianceOf(uint texel) {
    return vec3(radiance[3u * texel], radiance[3u * texel + 1u], radiance[3u * texel + 2u]);
}

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint receiver = gl_WorkGroupID.x;
    vec3 total = vec3(0.0);
    for (uint ray = firstRay[receiver] + lane; ray < firstRay[receiver + 1u]; ray += 64u)
        total += uintBitsToFloat(rays[ray].y) * radianceOf(rays[ray].x);
    sums[lane] = total;
    barrier();
    for (uint half_ = 32u; half_ > 0u; half_ >>= 1) {
        if (lane < half_) sums[lane] += sums[lane + half_];
        barrier();
    }
    if (lane == 0u) {
        vec3 own = vec3(0.0);
        for (uint k = 0u; k < uPatchTexels; ++k) own += radianceOf(patches[uPatchTexels * receiver + k]);
        own /= float(uPatchTexels);
        for (uint channel = 0u; channel < 3u; ++channel) {
            shown[6u * receiver + channel] = own[channel];
            shown[6u * receiver + 3u + channel] = sums[0][channel];
        }
    }
}

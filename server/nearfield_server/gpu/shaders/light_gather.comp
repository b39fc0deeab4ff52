#version 430
// Radiance per texel from all cameras through the packed gather table. One work group = one block of 64 texels.
layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Pairs { uint pairs[]; };           // 3 per pair: camera and pixel, upper taps, lower taps
layout(std430, binding = 1) readonly buffer PairStart { uint pairStart[]; };   // N + 1
layout(std430, binding = 2) readonly buffer Pixels { uvec2 pixels[]; };        // RGBA half, all cameras one after the other
layout(std430, binding = 3) writeonly buffer Radiance { float radiance[]; };   // 3 N

const uint MAX_CAMERAS = 16u;
const float HALF_MAX = 65504.0;
uniform uint uNumTexels;
uniform uint uCameraFirst[MAX_CAMERAS];  // first pixel of each camera
uniform uint uCameraWidth[MAX_CAMERAS];  // pixels per row; 0 = no picture

// Colour multiplied by validity, cleaned: NaN and negative values become 0, infinity the largest half.
vec4 loadPixel(uint index) {
    uvec2 packedPixel = pixels[index];
    vec4 value = vec4(unpackHalf2x16(packedPixel.x), unpackHalf2x16(packedPixel.y));
    value = mix(vec4(0.0), value, greaterThan(value, vec4(0.0)));
    value = min(value, vec4(HALF_MAX));
    return value * value.a;
}

void main() {
    uint texel = gl_GlobalInvocationID.x;
    if (texel >= uNumTexels) return;
    vec4 total = vec4(0.0);
    for (uint k = pairStart[texel]; k < pairStart[texel + 1u]; ++k) {
        uint place = pairs[3u * k];
        uint camera = place >> 28;
        uint width = uCameraWidth[camera];
        if (width == 0u) continue;
        uint first = uCameraFirst[camera] + (place & 0x0FFFFFFFu);
        uint upper = pairs[3u * k + 1u];
        uint lower = pairs[3u * k + 2u];
        total += float(upper & 0xFFFFu) * loadPixel(first) + float(upper >> 16) * loadPixel(first + 1u);
        total += float(lower & 0xFFFFu) * loadPixel(first + width) + float(lower >> 16) * loadPixel(first + width + 1u);
    }
    vec3 value = total.a > 0.0 ? total.rgb / total.a : vec3(0.0);
    radiance[3u * texel] = value.r;
    radiance[3u * texel + 1u] = value.g;
    radiance[3u * texel + 2u] = value.b;
}

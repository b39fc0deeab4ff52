#version 430
// Position in texel order behind the fragment, -1 for back faces; exact in float32 below 2^24.
in vec2 vUv;

uniform isampler2D uTexelIds;  // x: position in texel order or -1, y: triangle
uniform bool uIsMirrored;

out float outTexel;

const int SEARCH_RANGE = 3;

void main() {
    outTexel = -1.0;
    if (gl_FrontFacing == uIsMirrored) return;
    ivec2 size = textureSize(uTexelIds, 0);
    vec2 point = vUv * vec2(size) - 0.5;
    ivec2 nearest = ivec2(floor(point + 0.5));
    // Fragments at a chart border fall on texels of no or another triangle: take the nearest texel of their own, or the
    // nearest of all where their triangle has none around.
    float best = 1e9;
    float bestOfAll = 1e9;
    float texelOfAll = -1.0;
    for (int row = -SEARCH_RANGE; row <= SEARCH_RANGE; ++row) {
        for (int column = -SEARCH_RANGE; column <= SEARCH_RANGE; ++column) {
            ivec2 texel = nearest + ivec2(column, row);
            if (any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, size))) continue;
            ivec2 id = texelFetch(uTexelIds, texel, 0).xy;
            vec2 offset = vec2(texel) - point;
            float squared = dot(offset, offset);
            if (id.y == gl_PrimitiveID && squared < best) {
                best = squared;
                outTexel = float(id.x);
            }
            if (id.x >= 0 && squared < bestOfAll) {
                bestOfAll = squared;
                texelOfAll = float(id.x);
            }
        }
    }
    if (outTexel < 0.0) outTexel = texelOfAll;
}

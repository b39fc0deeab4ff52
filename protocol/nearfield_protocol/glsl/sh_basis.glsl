// Real orthonormal spherical harmonics of bands 0 to 2; order and axes: protocol/CONVENTIONS.md.
// Pure functions, valid in GLSL 330 core and GLSL ES 3.00.

// Y_k(direction) for k = 0..8; direction is a unit vector.
void shBasis(const in vec3 direction, out float basis[9]) {
  float x = direction.x;
  float y = direction.y;
  float z = direction.z;
  basis[0] = 0.28209479177387814;
  basis[1] = 0.4886025119029199 * y;
  basis[2] = 0.4886025119029199 * z;
  basis[3] = 0.4886025119029199 * x;
  basis[4] = 1.0925484305920792 * x * y;
  basis[5] = 1.0925484305920792 * y * z;
  basis[6] = 0.31539156525252005 * (3.0 * z * z - 1.0);
  basis[7] = 1.0925484305920792 * x * z;
  basis[8] = 0.5462742152960396 * (x * x - y * y);
}

// Radiance (or any other quantity) that the coefficients describe in one direction.
vec3 shEvaluate(const in vec3 coeffs[9], const in vec3 direction) {
  float basis[9];
  shBasis(direction, basis);
  vec3 sum = vec3(0.0);
  for (int k = 0; k < 9; ++k) sum += coeffs[k] * basis[k];
  return sum;
}

// Irradiance on an unoccluded surface with this unit normal: bands are weighted by pi, 2 pi / 3 and pi / 4
// (Ramamoorthi and Hanrahan 2001, Eq. 8).
vec3 shIrradiance(const in vec3 coeffs[9], const in vec3 normal) {
  float basis[9];
  shBasis(normal, basis);
  vec3 sum = 3.141592653589793 * coeffs[0] * basis[0];
  for (int k = 1; k < 4; ++k) sum += 2.0943951023931953 * coeffs[k] * basis[k];
  for (int k = 4; k < 9; ++k) sum += 0.7853981633974483 * coeffs[k] * basis[k];
  return sum;
}

// Irradiance from a virtual area light (protocol/CONVENTIONS.md; Rohmer et al. 2014, Eq. 6).
// Differs from the paper: area / pi in the denominator, exact on the axis of a parallel diffuse disc and free of the singularity.
// Pure functions, valid in GLSL 330 core and GLSL ES 3.00.

// Geometric factor in 1/m^2; times radiant intensity (W/sr) it is irradiance (W/m^2). Positions in metres, unit normals.
float valGeometry(
  const in vec3 position,
  const in vec3 normal,
  const in vec3 valPosition,
  const in vec3 valNormal,
  const in float valArea
) {
  vec3 toVal = valPosition - position;
  float distanceSquared = dot(toVal, toVal);
  float scale = distanceSquared > 0.0 ? inversesqrt(distanceSquared) : 0.0;
  float receiverCosine = max(dot(normal, toVal) * scale, 0.0);
  float valCosine = max(-dot(valNormal, toVal) * scale, 0.0);
  float denominator = distanceSquared + valArea * 0.3183098861837907;
  return denominator > 0.0 ? receiverCosine * valCosine / denominator : 0.0;
}

// Unoccluded irradiance in W/m^2.
vec3 valIrradiance(
  const in vec3 position,
  const in vec3 normal,
  const in vec3 valPosition,
  const in vec3 valNormal,
  const in float valArea,
  const in vec3 valRadiantIntensity
) {
  return valRadiantIntensity * valGeometry(position, normal, valPosition, valNormal, valArea);
}

// Whether a virtual object can stand between the disc of a VAL and some point of a ball (centre, radius): conservative and, for radius 0,
// exact for the ball around the disc. Inner tangent cone of the two spheres; needs object_data and val_data.
bool ballInShadowCone(Val val, vec3 centre, float radius) {
  for (int object = 0; object < uNumObjects; object++) {
    vec4 sphere = objectSphere(object);
    vec3 toObject = sphere.xyz - val.positionWorld;
    float apart = length(toObject);
    float radii = sphere.w + val.discRadius;
    if (apart <= radii * 1.001) {
      return true;
    }
    vec3 axis = toObject / apart;
    float sine = radii / apart;
    float cosine = sqrt(1.0 - sine * sine);
    vec3 apex = val.positionWorld + axis * (apart * val.discRadius / radii);
    vec3 fromApex = centre - apex;
    float along = dot(fromApex, axis);
    float across = length(fromApex - along * axis);
    bool beyond = dot(centre - val.positionWorld, axis) + radius >= apart - sphere.w;
    if (beyond && across * cosine - along * sine <= radius) {
      return true;
    }
  }
  return false;
}

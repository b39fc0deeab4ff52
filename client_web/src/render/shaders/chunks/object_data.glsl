// One row of the data texture per virtual object; written by objectData.ts.
uniform highp sampler2D uObjectData;
uniform int uNumObjects;

vec4 objectRow(int object, int column) {
  return texelFetch(uObjectData, ivec2(column, object), 0);
}

// World centre and radius of the bounding sphere.
vec4 objectSphere(int object) {
  return objectRow(object, 25);
}

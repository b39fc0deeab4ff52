// One row of the data texture per VAL; written by lightData.ts.
uniform highp sampler2D uValData;

struct Val {
  vec3 positionWorld;
  float area;
  vec3 normalWorld;
  float discRadius;
  vec3 radiantIntensity;
  // Share of the disc that the fixture leaves visible, mean over the virtual objects.
  float openShare;
  // Axes of the shadow map, world: right, up and the viewing direction.
  vec3 right;
  vec3 up;
  vec3 axis;
  // Slope (x / z, y / z) to place in the tile: slope * scale + offset.
  vec2 scale;
  vec2 offset;
  // Distance along the axis before which no virtual object lies.
  float nearestCaster;
  bool hasShadowMap;
};

Val fetchVal(int slot) {
  Val val;
  vec4 row = texelFetch(uValData, ivec2(0, slot), 0);
  val.positionWorld = row.xyz;
  val.area = row.w;
  row = texelFetch(uValData, ivec2(1, slot), 0);
  val.normalWorld = row.xyz;
  val.discRadius = row.w;
  row = texelFetch(uValData, ivec2(2, slot), 0);
  val.radiantIntensity = row.rgb;
  val.openShare = row.a;
  row = texelFetch(uValData, ivec2(3, slot), 0);
  val.right = row.xyz;
  val.scale.x = row.w;
  row = texelFetch(uValData, ivec2(4, slot), 0);
  val.up = row.xyz;
  val.scale.y = row.w;
  row = texelFetch(uValData, ivec2(5, slot), 0);
  val.axis = row.xyz;
  val.hasShadowMap = row.w > 0.5;
  row = texelFetch(uValData, ivec2(6, slot), 0);
  val.offset = row.xy;
  val.nearestCaster = row.z;
  return val;
}

// The same as seen from one virtual object.
float openShareOf(int slot, int object) {
  return texelFetch(uValData, ivec2(8 + object / 4, slot), 0)[object % 4];
}

// Irradiance of an unoccluded VAL: disc form of protocol/CONVENTIONS.md (Rohmer et al. 2014, Eq. 6, without its singularity).
vec3 valIrradiance(Val val, vec3 positionWorld, vec3 normalWorld) {
  vec3 toVal = val.positionWorld - positionWorld;
  float squared = dot(toVal, toVal);
  vec3 direction = toVal * inversesqrt(max(squared, 1e-12));
  float cosines = max(0.0, dot(normalWorld, direction)) * max(0.0, -dot(val.normalWorld, direction));
  return val.radiantIntensity * (cosines / (squared + val.area * 0.3183098861837907));
}

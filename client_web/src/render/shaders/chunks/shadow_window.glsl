// Axes and window of one shadow map. Needs val_data.
uniform float uShadowNear;
// Tiles per side of the atlas, texels per side of a tile.
uniform vec2 uShadowLayout;

vec3 toMapAxes(Val val, vec3 v) {
  return vec3(dot(val.right, v), dot(val.up, v), dot(val.axis, v));
}

// Slopes of the disc's two half axes at distance 1, as columns: light point = disc * (point of the unit disc).
mat2 discAxes(Val val) {
  vec3 n = toMapAxes(val, val.normalWorld);
  vec3 first = normalize(abs(n.x) < 0.7 ? cross(n, vec3(1.0, 0.0, 0.0)) : cross(n, vec3(0.0, 1.0, 0.0)));
  vec3 second = cross(n, first);
  return mat2(first.xy, second.xy) * val.discRadius;
}

float slopePerTexel(Val val) {
  return max(1.0 / val.scale.x, 1.0 / val.scale.y) / uShadowLayout.y;
}

// A receiver's plane is moved towards the VAL by the slope of one texel, so a flat receiver never shades itself, however wide the
// filter is: by this share of its distance, and by this length (metres).
const float SHADOW_OFFSET = 0.0005;

float shadowBias(float texelSlope, float steepness) {
  return min(texelSlope * (0.7 + steepness), 0.9);
}

vec2 tileOrigin(int slot) {
  int side = int(uShadowLayout.x);
  return vec2(slot % side, slot / side);
}

bool insideWindow(vec2 place) {
  return all(greaterThanEqual(place, vec2(0.0))) && all(lessThanEqual(place, vec2(1.0)));
}

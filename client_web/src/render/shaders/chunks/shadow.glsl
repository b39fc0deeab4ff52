// Soft shadows of the VAL discs from one depth map per VAL and layer (percentage-closer soft shadows, Fernando 2005).
// Each atlas is bound twice: once to read depths, once with the hardware comparison. Needs val_data.
uniform highp sampler2D uVirtualDepth;
uniform highp sampler2DShadow uVirtualCompare;
uniform highp sampler2D uRoomDepth;
uniform highp sampler2DShadow uRoomCompare;
uniform float uShadowNear;
// Tiles per side of the atlas, texels per side of a tile.
uniform vec2 uShadowLayout;
uniform int uSearchTaps;
uniform int uFilterTaps;

// A receiver in the axes of one shadow map.
struct Receiver {
  vec3 position;
  vec3 normal;
  // Slope of the disc's two half axes: light point = disc * (point of the unit disc).
  mat2 disc;
  // Pattern of the taps, turned by this angle.
  float turn;
  vec2 tileOrigin;
};

// Fixed per fragment, so still pictures do not shimmer (Jimenez 2014).
float interleavedNoise(vec2 fragment) {
  return fract(52.9829189 * fract(dot(fragment, vec2(0.06711056, 0.00583715))));
}

vec2 vogelPoint(int i, int count, float turn) {
  float angle = float(i) * 2.399963229728653 + turn;
  return sqrt((float(i) + 0.5) / float(count)) * vec2(cos(angle), sin(angle));
}

// Denser towards the centre, where alone blockers close to the receiver are found; `share` makes up for the density.
vec2 searchPoint(int i, int count, float turn, out float share) {
  float t = (float(i) + 0.25) / float(count);
  float angle = float(i) * 2.399963229728653 + turn;
  share = t * t * t;
  return t * t * vec2(cos(angle), sin(angle));
}

vec3 toMapAxes(Val val, vec3 v) {
  return vec3(dot(val.right, v), dot(val.up, v), dot(val.axis, v));
}

Receiver makeReceiver(Val val, int slot, vec3 positionWorld, vec3 normalWorld, float turn) {
  Receiver receiver;
  receiver.position = toMapAxes(val, positionWorld - val.positionWorld);
  receiver.normal = toMapAxes(val, normalWorld);
  vec3 n = toMapAxes(val, val.normalWorld);
  vec3 first = normalize(abs(n.x) < 0.7 ? cross(n, vec3(1.0, 0.0, 0.0)) : cross(n, vec3(0.0, 1.0, 0.0)));
  vec3 second = cross(n, first);
  receiver.disc = mat2(first.xy, second.xy) * val.discRadius;
  receiver.turn = turn;
  int side = int(uShadowLayout.x);
  receiver.tileOrigin = vec2(slot % side, slot / side);
  return receiver;
}

// Depth at which the tangent plane of the receiver meets the ray with this slope, moved towards the VAL by the slope of one texel:
// a flat receiver never shades itself, however wide the filter is.
float receiverDepth(Receiver receiver, Val val, vec2 slope, float steepest) {
  float plane = dot(receiver.normal, receiver.position);
  float facing = dot(receiver.normal, vec3(slope, 1.0));
  float z = receiver.position.z;
  // Beyond the horizon of the plane there is no meeting point: fall back to a plane facing the VAL.
  float meeting = facing < -1e-3 && plane < 0.0 ? clamp(plane / facing, 0.5 * z, 2.0 * z) : z;
  float texelSlope = max(1.0 / val.scale.x, 1.0 / val.scale.y) / uShadowLayout.y;
  float steepness = min(length(receiver.normal.xy) / max(-facing, 0.05), steepest);
  float bias = meeting * texelSlope * (0.7 + steepness) + 0.0005;
  return 1.0 - uShadowNear / max(meeting - bias, uShadowNear);
}

// Atlas coordinate, clamped to the tile; z < 0.5 when the slope lies outside the tile.
vec3 atlasPlace(Receiver receiver, Val val, vec2 slope) {
  vec2 place = slope * val.scale + val.offset;
  bool inside = all(greaterThanEqual(place, vec2(0.0))) && all(lessThanEqual(place, vec2(1.0)));
  float margin = 0.5 / uShadowLayout.y;
  vec2 kept = clamp(place, margin, 1.0 - margin);
  return vec3((receiver.tileOrigin + kept) / uShadowLayout.x, inside ? 1.0 : 0.0);
}

vec2 keptSlope(Receiver receiver, Val val, vec3 place, vec2 slope, bool beyond) {
  // What goes on as at the border is compared with the receiver's plane at the border.
  return beyond && place.z < 0.5 ? (place.xy * uShadowLayout.x - receiver.tileOrigin - val.offset) / val.scale : slope;
}

// Mean depth of what hides the disc, or a negative number when nothing does. `beyond`: what lies outside the window goes on as at its
// border (the room), or is empty (virtual objects, which the window holds whole).
float meanBlockerDepth(sampler2D depths, Receiver receiver, Val val, float nearest, bool beyond) {
  vec2 slope = receiver.position.xy / receiver.position.z;
  float inverse = 1.0 / receiver.position.z;
  float reach = max(1.0 / nearest - inverse, 0.0);
  // At least one texel, so that a tiny disc still finds what its filter will see.
  float texelSlope = max(1.0 / val.scale.x, 1.0 / val.scale.y) / uShadowLayout.y;
  float sum = 0.0;
  float count = 0.0;
  for (int i = 0; i < uSearchTaps; i++) {
    float share;
    vec2 unit = searchPoint(i, uSearchTaps, receiver.turn, share);
    vec2 tap = slope + receiver.disc * unit * reach + unit * texelSlope;
    vec3 place = atlasPlace(receiver, val, tap);
    float depth = textureLod(depths, place.xy, 0.0).r;
    // A blocker counts only if it stands between the receiver and a point of the disc.
    float own = (1.0 - depth) / uShadowNear - inverse;
    bool blocks = (beyond || place.z > 0.5) && depth < receiverDepth(receiver, val, keptSlope(receiver, val, place, tap, beyond), beyond ? 8.0 : 0.0) && own * 1.05 + 0.1 * texelSlope >= length(unit) * reach;
    sum += blocks ? share * depth : 0.0;
    count += blocks ? share : 0.0;
  }
  return count > 0.0 ? sum / count : -1.0;
}

float filteredVisibility(sampler2DShadow compared, Receiver receiver, Val val, float blockerDepth, bool beyond) {
  vec2 slope = receiver.position.xy / receiver.position.z;
  // Depth is linear in 1/z, so the penumbra w = D (z_r - z_b) / (z_r z_b) in slopes is D times a difference of depths.
  float spread = max((1.0 - blockerDepth) / uShadowNear - 1.0 / receiver.position.z, 0.0);
  float seen = 0.0;
  for (int i = 0; i < uFilterTaps; i++) {
    vec2 tap = slope + receiver.disc * vogelPoint(i, uFilterTaps, receiver.turn) * spread;
    vec3 place = atlasPlace(receiver, val, tap);
    float lit = textureLod(compared, vec3(place.xy, receiverDepth(receiver, val, keptSlope(receiver, val, place, tap, beyond), beyond ? 8.0 : 0.0)), 0.0);
    seen += beyond || place.z > 0.5 ? lit : 1.0;
  }
  return seen / float(uFilterTaps);
}

float virtualVisibility(Receiver receiver, Val val) {
  if (receiver.position.z <= uShadowNear) {
    return 1.0;
  }
  float nearest = min(val.nearestCaster, receiver.position.z);
  float blocker = meanBlockerDepth(uVirtualDepth, receiver, val, nearest, false);
  return blocker < 0.0 ? 1.0 : filteredVisibility(uVirtualCompare, receiver, val, blocker, false);
}

float roomVisibility(Receiver receiver, Val val) {
  if (receiver.position.z <= uShadowNear) {
    return 1.0;
  }
  // Real blockers may stand anywhere; a search wider than three discs would miss the small ones between its taps.
  float blocker = meanBlockerDepth(uRoomDepth, receiver, val, 0.25 * receiver.position.z, true);
  return blocker < 0.0 ? 1.0 : filteredVisibility(uRoomCompare, receiver, val, blocker, true);
}

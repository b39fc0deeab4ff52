// Soft shadows of the VAL discs from one depth map per VAL and layer (percentage-closer soft shadows, Fernando 2005).
// Everything is kept in places of the map and in inverse depths 1 / z: planes are linear there, so a tap costs a few additions.
// Each atlas is bound twice: once to read depths, once with the hardware comparison. Needs val_data and shadow_window.
uniform highp sampler2D uVirtualDepth;
uniform highp sampler2DShadow uVirtualCompare;
uniform highp sampler2D uRoomDepth;
uniform highp sampler2DShadow uRoomCompare;
uniform int uSearchTaps;
uniform int uFilterTaps;
// Fewer taps where the penumbra is narrow.
uniform bool uAdaptive;
// Written by shadowTaps.ts: xy in the unit disc, share, distance from the centre.
uniform vec4 uSearchPoints[48];
uniform vec2 uFilterPoints[96];

// A receiver in one shadow map.
struct Receiver {
  vec2 place;
  // 1 / z, and its change per place along the receiver's plane.
  float inverse;
  vec2 change;
  // 1 / z at the horizon of that plane: no meeting point beyond.
  float horizon;
  float steepness;
  // Change of place per unit of 1 / z, for points of the unit disc turned by the pattern's angle.
  mat2 disc;
  // The same for one texel.
  mat2 texel;
  float texelSlope;
  vec2 origin;
};

// Fixed per fragment, so still pictures do not shimmer (Jimenez 2014).
mat2 tapRotation(vec2 fragment) {
  float noise = fract(52.9829189 * fract(dot(fragment, vec2(0.06711056, 0.00583715))));
  float turn = 6.283185307179586 * noise;
  return mat2(cos(turn), sin(turn), -sin(turn), cos(turn));
}

Receiver makeReceiver(Val val, int slot, vec3 positionWorld, vec3 normalWorld, mat2 rotation) {
  Receiver receiver;
  vec3 position = toMapAxes(val, positionWorld - val.positionWorld);
  vec3 normal = toMapAxes(val, normalWorld);
  receiver.inverse = 1.0 / position.z;
  vec2 slope = position.xy * receiver.inverse;
  receiver.place = slope * val.scale + val.offset;
  float plane = min(dot(normal, position), -1e-6);
  receiver.change = normal.xy / (plane * val.scale);
  receiver.horizon = -1e-3 / plane;
  float facing = dot(normal, vec3(slope, 1.0));
  receiver.steepness = min(length(normal.xy) / max(-facing, 0.05), 8.0);
  mat2 disc = discAxes(val);
  disc[0] *= val.scale;
  disc[1] *= val.scale;
  receiver.disc = disc * rotation;
  receiver.texelSlope = slopePerTexel(val);
  vec2 texel = val.scale * receiver.texelSlope;
  receiver.texel = mat2(texel.x, 0.0, 0.0, texel.y) * rotation;
  receiver.origin = tileOrigin(slot);
  return receiver;
}

// Factor and summand that move an inverse depth towards the VAL.
vec2 biasOf(Receiver receiver, float steepness) {
  return vec2(1.0 / (1.0 - shadowBias(receiver.texelSlope, steepness)), SHADOW_OFFSET * receiver.inverse * receiver.inverse);
}

// Inverse depth of the receiver's plane in a place, towards which blockers are compared.
float planeInverse(Receiver receiver, vec2 bias, vec2 place) {
  float meeting = receiver.inverse + dot(receiver.change, place - receiver.place);
  meeting = meeting > receiver.horizon ? clamp(meeting, 0.5 * receiver.inverse, 2.0 * receiver.inverse) : receiver.inverse;
  return meeting * bias.x + bias.y;
}

vec2 keptPlace(vec2 place) {
  float margin = 0.5 / uShadowLayout.y;
  return clamp(place, margin, 1.0 - margin);
}

// Mean inverse depth of what hides the disc, or a negative number when nothing does. `goesOn`: what lies outside the window goes on as
// at its border (the room), or is empty (virtual objects, which the window holds whole).
float meanBlocker(sampler2D depths, Receiver receiver, float nearest, vec2 bias, bool goesOn, int taps) {
  float reach = max(1.0 / nearest - receiver.inverse, 0.0);
  // At least one texel, so that a tiny disc still finds what its filter will see.
  mat2 spread = receiver.disc * reach + receiver.texel;
  float nearer = 0.1 * receiver.texelSlope;
  // The first of `uSearchTaps` points, moved out to where as many of their own would lie.
  float widening = float(uSearchTaps) / float(max(taps, 1));
  widening *= widening;
  float sum = 0.0;
  float count = 0.0;
  for (int i = 0; i < taps; i++) {
    vec4 tap = uSearchPoints[i];
    tap.xyw *= widening;
    vec2 place = receiver.place + spread * tap.xy;
    vec2 kept = keptPlace(place);
    float found = (1.0 - textureLod(depths, (receiver.origin + kept) / uShadowLayout.x, 0.0).r) / uShadowNear;
    // A blocker counts only if it stands between the receiver and a point of the disc.
    bool blocks = (goesOn || insideWindow(place)) && found > planeInverse(receiver, bias, goesOn ? kept : place) &&
      (found - receiver.inverse) * 1.05 + nearer >= tap.w * reach;
    sum += blocks ? tap.z * found : 0.0;
    count += blocks ? tap.z : 0.0;
  }
  return count > 0.0 ? sum / count : -1.0;
}

float filteredVisibility(sampler2DShadow compared, Receiver receiver, float blocker, vec2 bias, bool goesOn, int taps) {
  // The penumbra w = D (z_r - z_b) / (z_r z_b) in slopes is D times a difference of inverse depths.
  mat2 spread = receiver.disc * max(blocker - receiver.inverse, 0.0);
  int count = taps;
  if (uAdaptive) {
    // Radius of the penumbra in texels, squared: comparisons are bilinear, so a tap per texel of its area is enough.
    float area = max(dot(spread[0], spread[0]), dot(spread[1], spread[1])) * uShadowLayout.y * uShadowLayout.y;
    count = min(taps, int(4.0 + 3.0 * area));
  }
  // The first points of the spiral of `uFilterTaps` lie in its middle.
  spread *= sqrt(float(uFilterTaps) / float(max(count, 1)));
  float seen = 0.0;
  for (int i = 0; i < count; i++) {
    vec2 place = receiver.place + spread * uFilterPoints[i];
    vec2 kept = keptPlace(place);
    float depth = 1.0 - uShadowNear * planeInverse(receiver, bias, goesOn ? kept : place);
    float lit = textureLod(compared, vec3((receiver.origin + kept) / uShadowLayout.x, depth), 0.0);
    seen += goesOn || insideWindow(place) ? lit : 1.0;
  }
  return count > 0 ? seen / float(count) : 1.0;
}

// `effort`: share of the taps that are read; with 0 the answer is 1.
float virtualVisibility(Receiver receiver, Val val, float effort) {
  bool reached = receiver.inverse > 0.0 && receiver.inverse < 1.0 / uShadowNear;
  vec2 bias = biasOf(receiver, 0.0);
  float nearest = min(val.nearestCaster, 1.0 / receiver.inverse);
  float blocker = meanBlocker(uVirtualDepth, receiver, nearest, bias, false, reached ? int(effort * float(uSearchTaps)) : 0);
  return filteredVisibility(uVirtualCompare, receiver, blocker, bias, false, blocker < 0.0 ? 0 : int(effort * float(uFilterTaps)));
}

float roomVisibility(Receiver receiver, Val val, float effort) {
  bool reached = receiver.inverse > 0.0 && receiver.inverse < 1.0 / uShadowNear;
  vec2 bias = biasOf(receiver, receiver.steepness);
  // Real blockers may stand anywhere; a search wider than three discs would miss the small ones between its taps.
  float blocker = meanBlocker(uRoomDepth, receiver, 0.25 / receiver.inverse, bias, true, reached ? int(effort * float(uSearchTaps)) : 0);
  return filteredVisibility(uRoomCompare, receiver, blocker, bias, true, blocker < 0.0 ? 0 : int(effort * float(uFilterTaps)));
}

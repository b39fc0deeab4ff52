// What the taps of all surfaces of a tile can meet in a shadow map, without reading them: conservative, so a tile that is called lit or
// dark shows exactly what its taps would have found. Needs val_data, shadow_window and tile_surfaces.
// Least and greatest inverse depth of squares of 4 and of 16 texels.
uniform highp sampler2D uVirtualBoundsFine;
uniform highp sampler2D uVirtualBoundsCoarse;
uniform highp sampler2D uRoomBoundsFine;
uniform highp sampler2D uRoomBoundsCoarse;
// Cells per side that are looked through; a tile that spreads over more stays undecided.
const int MOST_CELLS = 8;

const int UNDECIDED = 0;
const int LIT = 1;
const int DARK = 2;

struct Footprint {
  // Texels of the map that taps can read; whether all taps, and whether all surfaces, lie inside the window.
  vec2 low;
  vec2 high;
  bool inside;
  bool surfacesInside;
  // Inverse depths, after their bias, that taps compare with.
  float leastCompared;
  float mostCompared;
};

// `reach`: greatest difference of inverse depth between a blocker and the surfaces. `facing`: least cosine towards the VAL.
Footprint footprintOf(Val val, TileSurfaces tile, vec3 centre, float reach, float facing) {
  Footprint footprint;
  float nearest = centre.z - tile.radius;
  float farthest = centre.z + tile.radius;
  float texelSlope = slopePerTexel(val);
  mat2 disc = discAxes(val) * reach;
  vec2 slope = centre.xy / centre.z;
  vec2 tap = vec2(length(vec2(disc[0].x, disc[1].x)), length(vec2(disc[0].y, disc[1].y))) + texelSlope;
  vec2 ball = tile.radius * sqrt(1.0 + slope * slope) / nearest * val.scale;
  vec2 extent = tap * val.scale + ball;
  vec2 place = slope * val.scale + val.offset;
  footprint.inside = insideWindow(place - extent) && insideWindow(place + extent);
  footprint.surfacesInside = insideWindow(place - ball) && insideWindow(place + ball);
  footprint.low = (place - extent) * uShadowLayout.y - 1.0;
  footprint.high = (place + extent) * uShadowLayout.y + 1.0;
  // Along a receiver's plane 1 / z changes by at most this share on the way to a tap.
  float tilt = facing > 0.0 ? min(length(tap) / facing, 1.0) : 1.0;
  footprint.leastCompared = max(1.0 - tilt, 0.5) / farthest;
  footprint.mostCompared = (1.0 + tilt) / nearest / (1.0 - shadowBias(texelSlope, 0.0)) + SHADOW_OFFSET / (nearest * nearest);
  return footprint;
}

int decide(highp sampler2D fine, highp sampler2D coarse, int slot, Footprint footprint) {
  float cell = 4.0;
  ivec2 low = ivec2(floor(footprint.low / cell));
  ivec2 high = ivec2(floor(footprint.high / cell));
  bool useCoarse = any(greaterThanEqual(high - low, ivec2(MOST_CELLS)));
  if (useCoarse) {
    cell = 16.0;
    low = ivec2(floor(footprint.low / cell));
    high = ivec2(floor(footprint.high / cell));
  }
  int last = int(uShadowLayout.y / cell) - 1;
  low = clamp(low, ivec2(0), ivec2(last));
  high = clamp(high, ivec2(0), ivec2(last));
  ivec2 span = high - low + 1;
  if (any(greaterThan(span, ivec2(MOST_CELLS)))) {
    return UNDECIDED;
  }
  ivec2 origin = ivec2(tileOrigin(slot)) * (last + 1) + low;
  vec2 bounds = vec2(1e30, 0.0);
  for (int i = 0; i < span.x * span.y; i++) {
    ivec2 at = origin + ivec2(i % span.x, i / span.x);
    vec2 found = (useCoarse ? texelFetch(coarse, at, 0) : texelFetch(fine, at, 0)).rg;
    bounds = vec2(min(bounds.x, found.x), max(bounds.y, found.y));
  }
  if (bounds.y <= footprint.leastCompared) {
    return LIT;
  }
  return footprint.inside && bounds.x > footprint.mostCompared ? DARK : UNDECIDED;
}

int decideVirtual(Val val, int slot, TileSurfaces tile, vec3 centre, float facing) {
  float reach = max(1.0 / val.nearestCaster - 1.0 / (centre.z + tile.radius), 0.0);
  Footprint footprint = footprintOf(val, tile, centre, reach, facing);
  return decide(uVirtualBoundsFine, uVirtualBoundsCoarse, slot, footprint);
}

// Beyond the window of the room its border goes on, compared at the border: bounded only for surfaces inside. Blockers of the room may
// stand nearer than its search reaches, so what is dark stays undecided.
int decideRoom(Val val, int slot, TileSurfaces tile, vec3 centre, float facing) {
  Footprint footprint = footprintOf(val, tile, centre, 3.0 / (centre.z - tile.radius), facing);
  int found = decide(uRoomBoundsFine, uRoomBoundsCoarse, slot, footprint);
  return found == LIT && footprint.surfacesInside ? LIT : UNDECIDED;
}

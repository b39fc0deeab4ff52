#version 300 es
// One point of 8 fragments per tile of a wanted kind (bits); others are put out of sight.
uniform highp usampler2D uTileLights;
uniform uint uWantedKinds;
// Tiles per row and column; the viewport covers whole tiles.
uniform ivec2 uTiles;

void main() {
  ivec2 tile = ivec2(gl_VertexID % uTiles.x, gl_VertexID / uTiles.x);
  bool wanted = ((uWantedKinds >> texelFetch(uTileLights, tile, 0).z) & 1u) != 0u;
  gl_Position = wanted ? vec4((vec2(tile) + 0.5) / vec2(uTiles) * 2.0 - 1.0, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = 8.0;
}

#version 300 es
// One point of 8 fragments per tile that can hold the silhouette of a virtual object: it or a neighbour has virtual fragments.
uniform highp usampler2D uTileLights;
uniform ivec2 uTiles;

void main() {
  ivec2 tile = ivec2(gl_VertexID % uTiles.x, gl_VertexID / uTiles.x);
  bool wanted = false;
  for (int i = 0; i < 9; i++) {
    ivec2 near = clamp(tile + ivec2(i % 3, i / 3) - 1, ivec2(0), uTiles - 1);
    wanted = wanted || texelFetch(uTileLights, near, 0).z == 3u;
  }
  gl_Position = wanted ? vec4((vec2(tile) + 0.5) / vec2(uTiles) * 2.0 - 1.0, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = 8.0;
}

// What the G-buffer knows about the surfaces of a tile. Needs octahedral and surface.
const int TILE = 8;

struct TileSurfaces {
  bool anyReal;
  bool anyVirtual;
  // Ball around all surfaces.
  vec3 centreWorld;
  float radius;
  // Cone around all normals: axis, cosine and sine of the half angle.
  vec3 normalAxis;
  vec2 normalCone;
  float mostAlbedo;
};

TileSurfaces fetchTile(ivec2 first, ivec2 end) {
  TileSurfaces tile;
  tile.anyReal = false;
  tile.anyVirtual = false;
  tile.mostAlbedo = 0.0;
  float nearest = 1.0;
  float farthest = 0.0;
  vec3 least = vec3(1.0);
  vec3 most = vec3(-1.0);
  for (int y = first.y; y < end.y; y++) {
    for (int x = first.x; x < end.x; x++) {
      float depth = texelFetch(uDepth, ivec2(x, y), 0).r;
      vec4 albedo = texelFetch(uAlbedo, ivec2(x, y), 0);
      vec3 normal = decodeOctahedral(texelFetch(uNormal, ivec2(x, y), 0).rg);
      if (depth < 1.0) {
        bool isVirtual = albedo.a > 0.5;
        tile.anyVirtual = tile.anyVirtual || isVirtual;
        tile.anyReal = tile.anyReal || !isVirtual;
        tile.mostAlbedo = max(tile.mostAlbedo, max(albedo.r, max(albedo.g, albedo.b)));
        nearest = min(nearest, depth);
        farthest = max(farthest, depth);
        least = min(least, normal);
        most = max(most, normal);
      }
    }
  }
  // Ball around the frustum piece that holds all surfaces.
  float z0 = distanceFromDepth(nearest);
  float z1 = distanceFromDepth(farthest);
  vec2 low = vec2(first) - 0.5;
  vec2 high = vec2(end) - 0.5;
  vec3 centre = 0.5 * (cameraPoint(0.5 * (low + high), z0) + cameraPoint(0.5 * (low + high), z1));
  float radius = 0.0;
  for (int corner = 0; corner < 8; corner++) {
    vec2 at = vec2((corner & 1) == 0 ? low.x : high.x, (corner & 2) == 0 ? low.y : high.y);
    radius = max(radius, distance(centre, cameraPoint(at, (corner & 4) == 0 ? z0 : z1)));
  }
  tile.centreWorld = (uWorldFromCamera * vec4(centre, 1.0)).xyz;
  // Covers rounding of the positions and normals that the shading pass computes itself.
  tile.radius = radius * 1.001 + 1e-4;
  vec3 mean = 0.5 * (least + most);
  float spread = distance(mean, most) + 1e-4;
  float size = length(mean);
  tile.normalAxis = mean / max(size, 1e-6);
  float sine = spread / max(size, 1e-6);
  tile.normalCone = sine < 1.0 ? vec2(sqrt(1.0 - sine * sine), sine) : vec2(-1.0, 0.0);
  return tile;
}

// What virtual objects take from, and add to, the indirect light of a surface. Differs from the paper: Rohmer et al. 2014 leave it out.
// Needs object_data and sh_basis. Fields of all objects are stacked along z, three textures of four coefficients each (the last three unused).
uniform highp sampler3D uOcclusion0;
uniform highp sampler3D uOcclusion1;
uniform highp sampler3D uOcclusion2;
uniform vec3 uOcclusionSize;

vec3 evaluateRadiance(int object, int firstColumn, float y[9]) {
  vec3 sum = vec3(0.0);
  for (int k = 0; k < 9; k++) {
    sum += objectRow(object, firstColumn + k).rgb * y[k];
  }
  return max(sum, 0.0);
}

// What one object hides of a surface's hemisphere, by its occlusion O(w) around the point.
struct Hidden {
  // integral of O(w) max(0, n.w), in [0, pi]
  float solidAngle;
  // Mean direction of O, object axes; the normal too.
  vec3 direction;
  vec3 normal;
};

Hidden hiddenBy(int object, vec3 positionWorld, vec3 normalWorld) {
  Hidden hidden = Hidden(0.0, vec3(0.0), vec3(0.0));
  vec4 row0 = objectRow(object, 18);
  vec4 row1 = objectRow(object, 19);
  vec4 row2 = objectRow(object, 20);
  vec4 world = vec4(positionWorld, 1.0);
  vec3 positionObject = vec3(dot(row0, world), dot(row1, world), dot(row2, world));
  vec4 boxMin = objectRow(object, 21);
  vec4 boxSize = objectRow(object, 22);
  vec3 inBox = (positionObject - boxMin.xyz) / boxSize.xyz;
  vec3 edge = min(inBox, 1.0 - inBox);
  float inside = min(edge.x, min(edge.y, edge.z));
  if (inside <= 0.0) {
    return hidden;
  }
  // Fades out over a tenth of the box, so that its border does not show.
  float fade = smoothstep(0.0, 0.1, inside);
  vec3 cells = vec3(objectRow(object, 23).xy, boxSize.w);
  vec3 cell = clamp(inBox * cells, vec3(0.5), cells - 0.5);
  cell.z += boxMin.w;
  vec3 at = cell / uOcclusionSize;
  vec4 low = textureLod(uOcclusion0, at, 0.0);
  vec4 middle = textureLod(uOcclusion1, at, 0.0);
  float last = textureLod(uOcclusion2, at, 0.0).r;
  vec3 mean = vec3(low.w, low.y, low.z);
  float bend = length(mean);
  if (bend < 1e-5) {
    return hidden;
  }
  vec3 direction = mean / bend;
  vec3 n = vec3(dot(row0.xyz, normalWorld), dot(row1.xyz, normalWorld), dot(row2.xyz, normalWorld));
  float y[9];
  shBasis(n, y);
  // Clamped-cosine kernel pi, 2 pi / 3, pi / 4 per band.
  float blocked = 3.141592653589793 * low.x * y[0] + 2.0943951023931953 * dot(low.yzw, vec3(y[1], y[2], y[3])) +
    0.7853981633974483 * (dot(middle, vec4(y[4], y[5], y[6], y[7])) + last * y[8]);
  return Hidden(clamp(blocked, 0.0, 3.141592653589793) * fade, direction, n);
}

// Change of irradiance at a surface by one object: what it hides, times (its own radiance - radiance of what is hidden).
vec3 exchangedIrradiance(int object, vec3 positionWorld, vec3 normalWorld) {
  Hidden by = hiddenBy(object, positionWorld, normalWorld);
  if (by.solidAngle <= 0.0) {
    return vec3(0.0);
  }
  float y[9];
  shBasis(by.direction, y);
  vec3 hidden = evaluateRadiance(object, 0, y);
  // Column 9 onwards holds the irradiance of a surface of the object by its normal, kernel included.
  shBasis(-by.direction, y);
  vec3 bounced = objectRow(object, 24).rgb * 0.3183098861837907 * evaluateRadiance(object, 9, y);
  // The part of the object that faces the surface is lit by that surface, which keeps only what the object leaves it.
  bounced *= 1.0 - by.solidAngle * 0.3183098861837907 * max(0.0, dot(by.direction, by.normal));
  return by.solidAngle * (bounced - hidden);
}

// Shadowed over unshadowed irradiance of a real surface under the surrounding light of one object: Gierlinger et al. 2010, section 3.2.
// Differs from the paper, which multiplies the background by 1 - this ratio.
vec3 receiverRatio(int object, vec3 positionWorld, vec3 normalWorld) {
  Hidden by = hiddenBy(object, positionWorld, normalWorld);
  if (by.solidAngle <= 0.0) {
    return vec3(1.0);
  }
  float y[9];
  shBasis(by.normal, y);
  vec3 unshadowed = evaluateRadiance(object, 9, y);
  shBasis(by.direction, y);
  vec3 hidden = by.solidAngle * evaluateRadiance(object, 0, y);
  return clamp(1.0 - hidden / max(unshadowed, 1e-9), 0.0, 1.0);
}

#version 300 es
// Indirect radiance per vertex: Rohmer et al. 2014, Eq. 9. Differs from the paper: light that the object casts on itself is added,
// also that of the VALs, and
// what it keeps from the surface under it is missing.
layout(location = 0) in vec3 aPosition;
layout(location = 1) in vec3 aNormal;
layout(location = 2) in vec3 aShadowed0;
layout(location = 3) in vec3 aShadowed1;
layout(location = 4) in vec3 aShadowed2;
layout(location = 5) in vec3 aBounceOne0;
layout(location = 6) in vec3 aBounceOne1;
layout(location = 7) in vec3 aBounceOne2;
layout(location = 8) in vec3 aBounceTwo0;
layout(location = 9) in vec3 aBounceTwo1;
layout(location = 10) in vec3 aBounceTwo2;
layout(location = 11) in vec3 aGround0;
layout(location = 12) in vec3 aGround1;
layout(location = 13) in vec3 aGround2;
uniform mat4 uClipFromObject;
uniform mat3 uWorldFromObject;
uniform vec3 uAlbedoOfObject;
uniform float uBounceRatio;
// Of the surface that the object stands on; black where there is none.
uniform vec3 uGroundReflectance;
// Object axes; of the indirect light, and of all light that reaches the object (VALs included).
uniform vec3 uShIndirect[9];
uniform vec3 uShAll[9];
out vec3 vNormal;
out vec3 vRadiance;

vec3 gather(vec3 sh[9], vec3 t0, vec3 t1, vec3 t2) {
  return t0.x * sh[0] + t0.y * sh[1] + t0.z * sh[2] + t1.x * sh[3] + t1.y * sh[4] + t1.z * sh[5] +
    t2.x * sh[6] + t2.y * sh[7] + t2.z * sh[8];
}

void main() {
  vec3 albedo = uAlbedoOfObject;
  vec3 irradiance = gather(uShIndirect, aShadowed0, aShadowed1, aShadowed2) - uGroundReflectance * gather(uShAll, aGround0, aGround1, aGround2) +
    albedo * gather(uShAll, aBounceOne0, aBounceOne1, aBounceOne2) +
    albedo * albedo / (1.0 - albedo * uBounceRatio) * gather(uShAll, aBounceTwo0, aBounceTwo1, aBounceTwo2);
  vRadiance = albedo * 0.3183098861837907 * max(irradiance, 0.0);
  vNormal = uWorldFromObject * aNormal;
  gl_Position = uClipFromObject * vec4(aPosition, 1.0);
}

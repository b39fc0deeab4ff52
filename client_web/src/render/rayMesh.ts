/** Rays against triangle lists (Moeller and Trumbore 1997). */
import { cross, dot, subtract, type Vec3, vec3At } from './vector'

export interface Triangles {
  readonly positions: Float32Array
  readonly indices: Uint32Array
}

export interface Hit {
  /** In lengths of the ray's direction. */
  readonly distance: number
  readonly triangle: number
}

const EPSILON = 1e-12

/** Nearest hit with a distance in (0, `farthest`), or null; `frontOnly` ignores triangles seen from behind. */
export function castRay(
  triangles: Triangles,
  origin: Vec3,
  direction: Vec3,
  frontOnly: boolean,
  farthest = Number.POSITIVE_INFINITY,
): Hit | null {
  let distance = farthest
  let triangle = -1
  const { positions, indices } = triangles
  for (let i = 0; i + 2 < indices.length; i += 3) {
    const a = vec3At(positions, indices[i] ?? 0)
    const edge1 = subtract(vec3At(positions, indices[i + 1] ?? 0), a)
    const edge2 = subtract(vec3At(positions, indices[i + 2] ?? 0), a)
    const p = cross(direction, edge2)
    const determinant = dot(edge1, p)
    if (determinant < EPSILON && (frontOnly || determinant > -EPSILON)) continue
    const s = subtract(origin, a)
    const u = dot(s, p) / determinant
    if (u < 0 || u > 1) continue
    const q = cross(s, edge1)
    const v = dot(direction, q) / determinant
    if (v < 0 || u + v > 1) continue
    const t = dot(edge2, q) / determinant
    if (t > 0 && t < distance) {
      distance = t
      triangle = i / 3
    }
  }
  return triangle < 0 ? null : { distance, triangle }
}

/** Unit geometric normal, counter-clockwise side. */
export function triangleNormal(triangles: Triangles, triangle: number): Vec3 {
  const corner = (i: number): Vec3 => vec3At(triangles.positions, triangles.indices[3 * triangle + i] ?? 0)
  const n = cross(subtract(corner(1), corner(0)), subtract(corner(2), corner(0)))
  const size = Math.hypot(...n)
  return [n[0] / size, n[1] / size, n[2] / size]
}

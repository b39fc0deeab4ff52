/** Where virtual objects can stand: the upward-facing triangles of the room. */
import { Vector3 } from 'three'

export interface RoomTriangles {
  /** World, metres, 3 per vertex. */
  readonly positions: Float32Array
  readonly indices: Uint32Array
}

/** Steepest slope that still carries an object: 25 degrees. */
const MIN_NORMAL_Y = Math.cos((25 * Math.PI) / 180)
const EDGE_TOLERANCE = 1e-7

export class RoomSurface {
  /** 9 floats per triangle: corner, then both edges. */
  readonly #triangles: Float64Array

  constructor(room: RoomTriangles) {
    const kept: number[] = []
    const a = new Vector3()
    const edge1 = new Vector3()
    const edge2 = new Vector3()
    const normal = new Vector3()
    for (let i = 0; i + 2 < room.indices.length; i += 3) {
      a.fromArray(room.positions, 3 * (room.indices[i] as number))
      edge1.fromArray(room.positions, 3 * (room.indices[i + 1] as number)).sub(a)
      edge2.fromArray(room.positions, 3 * (room.indices[i + 2] as number)).sub(a)
      normal.crossVectors(edge1, edge2)
      if (normal.y > MIN_NORMAL_Y * normal.length()) {
        kept.push(...a.toArray(), ...edge1.toArray(), ...edge2.toArray())
      }
    }
    this.#triangles = Float64Array.from(kept)
  }

  /**
   * Nearest hit of a ray from above, after lifting the whole surface by `lift` metres.
   *
   * @returns the distance in lengths of `direction`, or null.
   */
  hit(origin: Vector3, direction: Vector3, lift = 0): number | null {
    const t = this.#triangles
    const originY = origin.y - lift
    let nearest = Number.POSITIVE_INFINITY
    for (let i = 0; i < t.length; i += 9) {
      // Moeller and Trumbore 1997, front faces only.
      const [ax, ay, az] = [t[i] as number, t[i + 1] as number, t[i + 2] as number]
      const [ux, uy, uz] = [t[i + 3] as number, t[i + 4] as number, t[i + 5] as number]
      const [vx, vy, vz] = [t[i + 6] as number, t[i + 7] as number, t[i + 8] as number]
      const px = direction.y * vz - direction.z * vy
      const py = direction.z * vx - direction.x * vz
      const pz = direction.x * vy - direction.y * vx
      const determinant = ux * px + uy * py + uz * pz
      if (determinant <= 0) {
        continue
      }
      const sx = origin.x - ax
      const sy = originY - ay
      const sz = origin.z - az
      const slack = EDGE_TOLERANCE * determinant
      const b1 = sx * px + sy * py + sz * pz
      if (b1 < -slack || b1 > determinant + slack) {
        continue
      }
      const qx = sy * uz - sz * uy
      const qy = sz * ux - sx * uz
      const qz = sx * uy - sy * ux
      const b2 = direction.x * qx + direction.y * qy + direction.z * qz
      if (b2 < -slack || b1 + b2 > determinant + slack) {
        continue
      }
      const distance = (vx * qx + vy * qy + vz * qz) / determinant
      if (distance > 0 && distance < nearest) {
        nearest = distance
      }
    }
    return Number.isFinite(nearest) ? nearest : null
  }

  /** Height of the highest surface at (x, z) that lies below `fromY`, or null. */
  heightBelow(x: number, z: number, fromY: number): number | null {
    const distance = this.hit(new Vector3(x, fromY, z), new Vector3(0, -1, 0))
    return distance === null ? null : fromY - distance
  }
}

/** What stands under a point of the picture. On the CPU, so that no frame waits for the GPU. */
import type { Lens } from './camera'
import { castRay, type Triangles, triangleNormal } from './rayMesh'
import { add, invertRigid, scale, subtract, transformPoint, type Vec3 } from './vector'

export interface PickScene {
  readonly room: Triangles
  readonly objects: readonly { readonly mesh: Triangles; readonly worldFromObject: ArrayLike<number> }[]
}

export interface PickResult {
  /** -1 = a real surface. */
  readonly objectIndex: number
  readonly positionWorld: Vec3
  /** Geometric, towards the viewer's side of the surface. */
  readonly normalWorld: Vec3
}

/** @param xNdc and yNdc: -1 to 1, y up. */
export function pickSurface(
  scene: PickScene,
  lens: Lens,
  worldFromCamera: ArrayLike<number>,
  xNdc: number,
  yNdc: number,
): PickResult | null {
  const pixelX = ((xNdc + 1) / 2) * lens.width - 0.5
  const pixelY = ((1 - yNdc) / 2) * lens.height - 0.5
  const origin = transformPoint(worldFromCamera, [0, 0, 0])
  const ahead: Vec3 = [(pixelX - lens.cx) / lens.fx, (pixelY - lens.cy) / lens.fy, 1]
  const direction = subtract(transformPoint(worldFromCamera, ahead), origin)
  const roomHit = castRay(scene.room, origin, direction, true)
  let nearest = roomHit?.distance ?? Number.POSITIVE_INFINITY
  let result: PickResult | null = roomHit && {
    objectIndex: -1,
    positionWorld: add(origin, scale(direction, roomHit.distance)),
    normalWorld: triangleNormal(scene.room, roomHit.triangle),
  }
  scene.objects.forEach(({ mesh, worldFromObject }, objectIndex) => {
    const objectFromWorld = invertRigid(worldFromObject)
    const start = transformPoint(objectFromWorld, origin)
    const towards = subtract(transformPoint(objectFromWorld, add(origin, direction)), start)
    const hit = castRay(mesh, start, towards, false, nearest)
    if (hit) {
      nearest = hit.distance
      const normal = triangleNormal(mesh, hit.triangle)
      result = {
        objectIndex,
        positionWorld: add(origin, scale(direction, hit.distance)),
        normalWorld: subtract(
          transformPoint(worldFromObject, normal),
          transformPoint(worldFromObject, [0, 0, 0]),
        ),
      }
    }
  })
  return result
}

/** The meshes of a scene on the GPU. */
import { GpuMesh } from './gl/mesh'
import type { ObjectAsset, SceneAssets } from './types'

export interface ObjectMeshes {
  readonly asset: ObjectAsset
  readonly full: GpuMesh
  readonly proxy: GpuMesh
}

export class SceneMeshes {
  readonly room: GpuMesh
  readonly objects: readonly ObjectMeshes[]

  constructor(gl: WebGL2RenderingContext, assets: SceneAssets) {
    const { room } = assets
    this.room = new GpuMesh(
      gl,
      [
        { location: 0, size: 3, data: room.positions },
        { location: 1, size: 3, data: room.normals },
        { location: 2, size: 3, data: room.albedo },
        { location: 3, size: 2, data: room.uv },
      ],
      room.indices,
    )
    this.objects = assets.objects.map((asset) => ({
      asset,
      full: new GpuMesh(
        gl,
        [
          { location: 0, size: 3, data: asset.positions },
          { location: 1, size: 3, data: asset.normals },
          ...[asset.shadowed, asset.bounce1, asset.bounce2, asset.groundShadow].flatMap((table, order) =>
            [0, 1, 2].map((part) => ({ location: 2 + 3 * order + part, size: 3, data: column(table, part) })),
          ),
        ],
        asset.indices,
      ),
      proxy: new GpuMesh(
        gl,
        [{ location: 0, size: 3, data: asset.shadowProxy.positions }],
        asset.shadowProxy.indices,
      ),
    }))
  }

  dispose(): void {
    this.room.dispose()
    for (const { full, proxy } of this.objects) {
      full.dispose()
      proxy.dispose()
    }
  }
}

/** Coefficients 3 part to 3 part + 2 of a table with nine per vertex. */
function column(table: Float32Array, part: number): Float32Array {
  const count = table.length / 9
  const result = new Float32Array(3 * count)
  for (let vertex = 0; vertex < count; vertex++) {
    result.set(table.subarray(9 * vertex + 3 * part, 9 * vertex + 3 * part + 3), 3 * vertex)
  }
  return result
}

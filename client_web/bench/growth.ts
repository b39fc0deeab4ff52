/** The scene grown in one direction, to see what a frame costs then. */
import { resizeLens } from '../src/render/camera'
import type { ObjectAsset } from '../src/render/types'
import type { BenchLight, BenchScene } from './scene'

export interface Growth {
  /** Size of the picture, pixels; default as loaded. */
  readonly width?: number
  readonly height?: number
  /** Each subdivision makes four triangles of one. */
  readonly subdivisions?: number
  /** Number of virtual objects; those of the scene are repeated. */
  readonly objects?: number
}

/** Metres between an object and its next copy. */
const COPY_STEP = 0.2

export function grow(
  scene: BenchScene,
  light: BenchLight,
  growth: Growth,
): { scene: BenchScene; light: BenchLight } {
  const { width = scene.lens.width, height = scene.lens.height, subdivisions = 0 } = growth
  const base = scene.assets.objects
  const count = growth.objects ?? base.length
  const objectSh = new Float32Array(27 * count)
  const objects = Array.from({ length: count }, (_, index) => {
    const source = index % base.length
    objectSh.set(light.objectSh.subarray(27 * source, 27 * (source + 1)), 27 * index)
    let object = moveCopy(base[source] as ObjectAsset, Math.floor(index / base.length))
    for (let i = 0; i < subdivisions; i++) object = subdivide(object)
    return object
  })
  return {
    scene: { ...scene, assets: { ...scene.assets, objects }, lens: resizeLens(scene.view, width, height) },
    light: { ...light, objectSh },
  }
}

/** Copies stand behind each other, in turn on both sides of the first. */
function moveCopy(object: ObjectAsset, copy: number): ObjectAsset {
  const worldFromObject = [...object.worldFromObject]
  const side = copy % 2 === 0 ? 1 : -1
  worldFromObject[11] = (worldFromObject[11] ?? 0) + side * Math.ceil(copy / 2) * COPY_STEP
  return { ...object, worldFromObject }
}

/** Splits every triangle at the middles of its edges; what vertices carry is interpolated. */
function subdivide(object: ObjectAsset): ObjectAsset {
  const numVertices = object.positions.length / 3
  const middles = new Map<number, number>()
  const ends: [number, number][] = []
  const middle = (a: number, b: number): number => {
    const key = Math.min(a, b) * numVertices + Math.max(a, b)
    const known = middles.get(key)
    if (known !== undefined) return known
    ends.push([a, b])
    middles.set(key, numVertices + ends.length - 1)
    return numVertices + ends.length - 1
  }
  const indices: number[] = []
  for (let i = 0; i < object.indices.length; i += 3) {
    const [a = 0, b = 0, c = 0] = object.indices.subarray(i, i + 3)
    const [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)]
    indices.push(a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca)
  }
  const interpolate = (values: Float32Array): Float32Array => {
    const size = values.length / numVertices
    const result = new Float32Array(size * (numVertices + ends.length))
    result.set(values)
    ends.forEach(([a, b], i) => {
      for (let k = 0; k < size; k++) {
        result[size * (numVertices + i) + k] =
          0.5 * ((values[size * a + k] ?? 0) + (values[size * b + k] ?? 0))
      }
    })
    return result
  }
  return {
    ...object,
    indices: Uint32Array.from(indices),
    positions: interpolate(object.positions),
    normals: interpolate(object.normals),
    shadowed: interpolate(object.shadowed),
    bounce1: interpolate(object.bounce1),
    bounce2: interpolate(object.bounce2),
    groundShadow: interpolate(object.groundShadow),
  }
}

/** Triangles of all virtual objects. */
export function trianglesOf(scene: BenchScene): number {
  return scene.assets.objects.reduce((sum, object) => sum + object.indices.length / 3, 0)
}

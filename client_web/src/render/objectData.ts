/** Packs virtual objects for the shaders; columns as read by chunks/object_data.glsl and chunks/indirect_exchange.glsl. */
import { SH_COUNT } from '../radiometry/sh'
import type { ObjectAsset } from './types'
import { invertRigid, transformPoint, type Vec3 } from './vector'

export const OBJECT_COLUMNS = 26
export const MAX_OBJECTS = 16
/** Clamped-cosine kernel by k: pi, 2 pi / 3, pi / 4. */
const KERNEL = [Math.PI, ...Array(3).fill((2 * Math.PI) / 3), ...Array(5).fill(Math.PI / 4)] as number[]

export interface ObjectState {
  readonly asset: ObjectAsset
  /** Column-major. */
  readonly worldFromObject: ArrayLike<number>
  /** Of the surface that the object stands on, black where there is none: groundContact.ts. */
  readonly groundReflectance: Vec3
  /** By slot: share of each VAL that its fixture leaves visible from here, fixtureVisibility.ts. */
  readonly openShare: Float32Array
  /** 27 each, object axes: indirect light, and all light (VALs included). */
  readonly shIndirect: Float32Array
  readonly shAll: Float32Array
}

export function packObjects(objects: readonly ObjectState[], slabStarts: readonly number[]): Float32Array {
  const data = new Float32Array(MAX_OBJECTS * OBJECT_COLUMNS * 4)
  objects.forEach((object, index) => {
    const put = (column: number, ...values: number[]): void =>
      data.set(values, (index * OBJECT_COLUMNS + column) * 4)
    for (let k = 0; k < SH_COUNT; k++) {
      put(k, ...object.shIndirect.slice(3 * k, 3 * k + 3))
      // As irradiance of a surface by its normal.
      put(SH_COUNT + k, ...object.shAll.slice(3 * k, 3 * k + 3).map((v) => v * (KERNEL[k] ?? 0)))
    }
    const inverse = invertRigid(object.worldFromObject)
    for (let row = 0; row < 3; row++) {
      put(18 + row, ...[0, 1, 2, 3].map((column) => inverse[4 * column + row] ?? 0))
    }
    const field = object.asset.occlusionField
    if (field) {
      put(21, ...field.boxMin, slabStarts[index] ?? 0)
      put(22, ...field.boxSize, field.resolution[2])
      put(23, field.resolution[0], field.resolution[1])
    } else {
      // A box that no point lies in.
      put(21, 1e9, 1e9, 1e9, 0)
      put(22, 1, 1, 1, 1)
      put(23, 1, 1)
    }
    put(24, ...object.asset.albedo)
    put(25, ...worldCentre(object), object.asset.radius)
  })
  return data
}

export function worldCentre(object: { asset: ObjectAsset; worldFromObject: ArrayLike<number> }): Vec3 {
  return transformPoint(object.worldFromObject, object.asset.centre)
}

export interface StackedFields {
  readonly size: readonly [number, number, number]
  /** RGBA half floats of the three textures. */
  readonly layers: readonly [Uint16Array, Uint16Array, Uint16Array]
  /** First cell along z of every object. */
  readonly slabStarts: readonly number[]
}

/** Stacks the occlusion fields of all objects along z, each in its own slab. */
export function stackFields(objects: readonly ObjectAsset[]): StackedFields {
  const fields = objects.map((object) => object.occlusionField)
  const largest = (axis: 0 | 1): number => Math.max(1, ...fields.map((field) => field?.resolution[axis] ?? 1))
  const width = largest(0)
  const height = largest(1)
  const slabStarts: number[] = []
  let depth = 0
  for (const field of fields) {
    slabStarts.push(depth)
    depth += field?.resolution[2] ?? 0
  }
  depth = Math.max(1, depth)
  const makeLayer = (): Uint16Array => new Uint16Array(width * height * depth * 4)
  const layers: [Uint16Array, Uint16Array, Uint16Array] = [makeLayer(), makeLayer(), makeLayer()]
  fields.forEach((field, index) => {
    if (!field) return
    const [nx, ny, nz] = field.resolution
    for (let row = 0; row < ny * nz; row++) {
      const y = row % ny
      const z = Math.floor(row / ny) + (slabStarts[index] ?? 0)
      for (let x = 0; x < nx; x++) {
        const source = 12 * (row * nx + x)
        const target = 4 * ((z * height + y) * width + x)
        layers.forEach((layer, part) => {
          layer.set(field.coeffs.subarray(source + 4 * part, source + 4 * part + 4), target)
        })
      }
    }
  })
  return { size: [width, height, depth], layers, slabStarts }
}

/** A page without app around the renderer, driven by tests/client. Built by vite.harness.config.ts only; never part of the product. */
import { DataUtils, Matrix4 } from 'three'
import { shBasis } from '../radiometry/sh'
import { FLOATS_PER_VAL, MAX_VALS } from '../radiometry/valLight'
import type { LightFrame } from '../state/lightState'
import type { SceneDescription } from '../state/sceneDescription'
import { loadSceneAssets } from './assets'
import type { ShadingMode } from './passes/shadePass'
import { Renderer } from './renderer'
import type {
  FrameStats,
  HalfPicture,
  ObjectAsset,
  OcclusionFieldAsset,
  RendererOptions,
  SceneAssets,
  ViewAsset,
} from './types'

interface PlainMesh {
  positions: number[]
  normals: number[]
  indices: number[]
}

/** A synthetic scene as JSON. */
interface PlainScene {
  room: PlainMesh & { albedo: number[]; uv?: number[] }
  objects: (PlainMesh & {
    albedo: [number, number, number]
    worldFromObject: number[]
    centre: [number, number, number]
    radius: number
    /** Transfer of an unoccluded surface; zero without it. */
    isConvex?: boolean
    /** An occlusion field that is the same everywhere in its box. */
    field?: { boxMin: [number, number, number]; boxSize: [number, number, number]; coeffs: number[] }
  })[]
  /** `background`: RGB per pixel, row 0 on top. */
  views: (Omit<ViewAsset, 'pictures'> & { background?: number[] })[]
}

/** Pictures hold half floats; three of them, each finer than the last, add up to float32. */
const PICTURE_UNITS = [1, 2 ** 11, 2 ** 22] as const

function splitPicture(view: PlainScene['views'][number]): HalfPicture[] {
  const { width, height, background } = view
  if (!background) return []
  const pictures = PICTURE_UNITS.map(() => ({ width, height, data: new Uint16Array(4 * width * height) }))
  background.forEach((value, i) => {
    const pixel = Math.floor(i / 3)
    const row = height - 1 - Math.floor(pixel / width)
    let rest = value
    pictures.forEach(({ data }, k) => {
      const unit = PICTURE_UNITS[k] ?? 1
      const half = DataUtils.toHalfFloat(rest * unit)
      data[4 * (row * width + (pixel % width)) + (i % 3)] = half
      rest -= DataUtils.fromHalfFloat(half) / unit
    })
  })
  return pictures
}

/** Clamped cosine about the normal: the transfer of a convex body. */
function convexTransfer(normals: readonly number[]): Float32Array {
  const table = new Float32Array(3 * normals.length)
  for (let vertex = 0; 3 * vertex < normals.length; vertex++) {
    const [x = 0, y = 0, z = 0] = normals.slice(3 * vertex, 3 * vertex + 3)
    table.set(
      shBasis(x, y, z).map(
        (value, k) => value * (k === 0 ? Math.PI : k < 4 ? (2 * Math.PI) / 3 : Math.PI / 4),
      ),
      9 * vertex,
    )
  }
  return table
}

function constantField(field: NonNullable<PlainScene['objects'][number]['field']>): OcclusionFieldAsset {
  const cell = [...field.coeffs, 0, 0, 0].map((value) => DataUtils.toHalfFloat(value))
  return {
    resolution: [4, 3, 2],
    boxMin: field.boxMin,
    boxSize: field.boxSize,
    coeffs: Uint16Array.from({ length: 24 * 12 }, (_, i) => cell[i % 12] ?? 0),
  }
}

interface PlainVal {
  position: number[]
  normal: number[]
  radiantIntensity: number[]
  area: number
}

function synthetic(scene: PlainScene): SceneAssets {
  const { room } = scene
  const roomAsset = {
    positions: Float32Array.from(room.positions),
    normals: Float32Array.from(room.normals),
    indices: Uint32Array.from(room.indices),
    albedo: Float32Array.from(room.albedo),
    uv: Float32Array.from(room.uv ?? Array((2 * room.positions.length) / 3).fill(0)),
  }
  return {
    room: roomAsset,
    objects: scene.objects.map((object): ObjectAsset => {
      const zeros = new Float32Array(3 * object.positions.length)
      return {
        name: 'synthetic',
        ...object,
        positions: Float32Array.from(object.positions),
        normals: Float32Array.from(object.normals),
        indices: Uint32Array.from(object.indices),
        shadowed: object.isConvex ? convexTransfer(object.normals) : zeros,
        bounce1: zeros,
        bounce2: zeros,
        groundShadow: zeros,
        bounceRatio: 0,
        shadowProxy: {
          positions: Float32Array.from(object.positions),
          indices: Uint32Array.from(object.indices),
        },
        occlusionField: object.field ? constantField(object.field) : null,
      }
    }),
    views: scene.views.map((view) => ({ ...view, pictures: splitPicture(view) })),
    lights: scene.views.some((view) => view.background)
      ? PICTURE_UNITS.map((unit) => ({ radiance: [1, 1, 1], basisRadiance: unit, weight: 1 }))
      : [],
    roomTriangles: {
      positions: roomAsset.positions,
      indices: roomAsset.indices,
      albedo: roomAsset.albedo,
    },
  }
}

function lightFrame(vals: readonly PlainVal[], objectSh: readonly number[]): LightFrame {
  const packed = new Float32Array(MAX_VALS * FLOATS_PER_VAL)
  vals.forEach((val, slot) => {
    packed.set([...val.position, val.area, ...val.normal, 0, ...val.radiantIntensity], slot * FLOATS_PER_VAL)
  })
  return {
    vals: packed,
    count: vals.length,
    objectSh: Float32Array.from(objectSh),
    positionsChanged: true,
    changedSlots: new Uint8Array(MAX_VALS).fill(1),
    revision: 1,
  }
}

async function toBase64(values: Float32Array): Promise<string> {
  const reader = new FileReader()
  const done = new Promise<string>((resolve) => {
    reader.onload = () => resolve((reader.result as string).split(',')[1] ?? '')
  })
  reader.readAsDataURL(new Blob([values as Float32Array<ArrayBuffer>]))
  return done
}

let current: Renderer | null = null

function renderer(): Renderer {
  if (!current) throw new Error('call create first')
  return current
}

async function start(assets: SceneAssets, options: Partial<RendererOptions>): Promise<void> {
  current?.dispose()
  document.querySelector('canvas')?.remove()
  const canvas = document.body.appendChild(document.createElement('canvas'))
  current = await Renderer.create(canvas, assets, options)
}

const harness = {
  create: (scene: PlainScene, options: Partial<RendererOptions>) => start(synthetic(scene), options),
  load: async (scene: SceneDescription, options: Partial<RendererOptions>) =>
    start(await loadSceneAssets(scene), options),
  setLight: (vals: PlainVal[], objectSh: number[] = []) => renderer().setLight(lightFrame(vals, objectSh)),
  setSize: (width: number, height: number) => renderer().setSize(width, height),
  setView: (viewIndex: number) => renderer().setCamera({ kind: 'tablet', viewIndex }),
  setFreeCamera: (rowMajor: number[], verticalFov: number) =>
    renderer().setCamera({
      kind: 'free',
      worldFromCamera: new Matrix4().fromArray(rowMajor).transpose(),
      verticalFov,
    }),
  setPose: (index: number, rowMajor: number[]) =>
    renderer().setObjectPose(index, new Matrix4().fromArray(rowMajor).transpose()),
  setWeights: (weights: number[]) => renderer().setLightWeights(Float32Array.from(weights)),
  setOptions: (options: Partial<RendererOptions>) => renderer().setOptions(options),
  setMode: (mode: ShadingMode) => renderer().setShadingMode(mode),
  /** RGB9_E5 words, tile by tile: 32 x 32 each. */
  setAtlas: (width: number, height: number, positions: number[], texels: number[]) =>
    renderer().updateAtlas({
      sequence: 1,
      timestampNs: 0n,
      roomRevision: 1,
      width,
      height,
      positions: Uint16Array.from(positions),
      texels: Uint32Array.from(texels),
    }),
  render: (): FrameStats => renderer().render(performance.now()),
  /** Draws until nothing is left over, then reads linear RGBA. */
  picture: (): Promise<string> => {
    while (renderer().render(performance.now()).pending);
    return toBase64(renderer().readComposite())
  },
  /** Takes the graphics context away and gives it back. */
  loseContext: async () => {
    const canvas = document.querySelector('canvas') as HTMLCanvasElement
    const extension = canvas.getContext('webgl2')?.getExtension('WEBGL_lose_context')
    const restored = new Promise((resolve) => canvas.addEventListener('webglcontextrestored', resolve))
    extension?.loseContext()
    await new Promise((resolve) => setTimeout(resolve, 100))
    extension?.restoreContext()
    await restored
  },
  pick: (x: number, y: number) => {
    const hit = renderer().pick(x, y)
    return hit && { objectIndex: hit.objectIndex, position: hit.positionWorld.toArray() }
  },
}

declare global {
  interface Window {
    harness: typeof harness
  }
}

window.harness = harness

/** The scene that every variant draws, and how it moves from frame to frame. */
import { decodeLightPacket } from '../src/protocol/codec'
import { FLOATS_PER_VAL, MAX_VALS } from '../src/radiometry/valLight'
import { loadSceneAssets } from '../src/render/assets'
import { type Lens, resizeLens } from '../src/render/camera'
import type { SceneAssets, ViewAsset } from '../src/render/types'
import { parseSceneDescription } from '../src/state/sceneDescription'

/** Metres that objects and VALs move between two frames: more than any tolerance of the renderer. */
const STEP = 0.01
/** Share by which the lamps of the background picture change between two frames. */
const WEIGHT_STEP = 0.02

/** One VAL as a spot light in another engine sees it. */
export interface SpotVal {
  readonly position: readonly [number, number, number]
  readonly normal: readonly [number, number, number]
  /** W/sr along the normal. */
  readonly radiantIntensity: readonly [number, number, number]
}

export interface BenchLight {
  /** VALs with light only. */
  readonly count: number
  /** FLOATS_PER_VAL per slot, MAX_VALS slots. */
  readonly vals: Float32Array
  /** 27 per object, W/m^2. */
  readonly objectSh: Float32Array
}

export interface BenchScene {
  readonly assets: SceneAssets
  readonly view: ViewAsset
  readonly lens: Lens
}

export async function loadBenchScene(width: number, height: number): Promise<BenchScene> {
  const description = parseSceneDescription(await (await fetch('api/scene')).json())
  const assets = await loadSceneAssets(description)
  const view = assets.views[0]
  if (!view) {
    throw new Error('The scene has no tablet view; the benchmark draws the first one.')
  }
  return { assets, view, lens: resizeLens(view, width, height) }
}

/** The VALs of a light packet (base64 of its bytes) that are lit, closed up. */
export function readLight(base64: string): BenchLight {
  const bytes = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0))
  const packet = decodeLightPacket(bytes.buffer)
  const vals = new Float32Array(MAX_VALS * FLOATS_PER_VAL)
  let count = 0
  for (let slot = 0; slot < packet.numVals; slot++) {
    const val = packet.vals.subarray(slot * FLOATS_PER_VAL, (slot + 1) * FLOATS_PER_VAL)
    if (Math.max(...val.subarray(8, 11)) > 0) {
      vals.set(val, count * FLOATS_PER_VAL)
      count++
    }
  }
  return { count, vals, objectSh: packet.objectSh }
}

/** -1 and 1 in turn: frame after frame everything stands elsewhere, and nothing drifts away. */
function swing(frame: number): number {
  return frame % 2 === 0 ? 1 : -1
}

/** Row-major pose of an object in a frame. */
export function objectPose(scene: BenchScene, index: number, frame: number): number[] {
  const pose = [...(scene.assets.objects[index]?.worldFromObject ?? [])]
  pose[3] = (pose[3] ?? 0) + 0.5 * STEP * swing(frame)
  return pose
}

/** VALs in a frame: each slides along its own surface, so none leaves the room. */
export function movedVals(light: BenchLight, frame: number): Float32Array {
  const vals = light.vals.slice()
  for (let slot = 0; slot < light.count; slot++) {
    const at = slot * FLOATS_PER_VAL
    const [nx = 0, ny = 0, nz = 0] = vals.subarray(at + 4, at + 7)
    // Perpendicular to the normal.
    const along = Math.abs(ny) < 0.9 ? [-nz, 0, nx] : [0, nz, -ny]
    const length = Math.hypot(...along)
    along.forEach((value, axis) => {
      vals[at + axis] = (vals[at + axis] ?? 0) + (0.5 * STEP * swing(frame) * value) / length
    })
  }
  return vals
}

export function spotsOf(vals: Float32Array, count: number): SpotVal[] {
  return Array.from({ length: count }, (_, slot) => {
    const at = (offset: number): number => vals[slot * FLOATS_PER_VAL + offset] ?? 0
    return {
      position: [at(0), at(1), at(2)],
      normal: [at(4), at(5), at(6)],
      radiantIntensity: [at(8), at(9), at(10)],
    }
  })
}

/** Lamp weights of the background picture in a frame: a new camera picture every time. */
export function lampWeights(scene: BenchScene, frame: number): Float32Array {
  return Float32Array.from(scene.assets.lights, (light) => light.weight * (1 + WEIGHT_STEP * swing(frame)))
}

/** Middle of the virtual objects: where the spot lights of the other engines aim. */
export function middleOfObjects(scene: BenchScene): [number, number, number] {
  const sum: [number, number, number] = [0, 0, 0]
  scene.assets.objects.forEach(({ centre, worldFromObject: m }) => {
    for (const axis of [0, 1, 2] as const) {
      const row = 4 * axis
      sum[axis] +=
        (m[row] ?? 0) * centre[0] +
        (m[row + 1] ?? 0) * centre[1] +
        (m[row + 2] ?? 0) * centre[2] +
        (m[row + 3] ?? 0)
    }
  })
  const count = Math.max(1, scene.assets.objects.length)
  return [sum[0] / count, sum[1] / count, sum[2] / count]
}

/** Loads what a scene description names: room, prepared objects, basis pictures of the views. */
import type {
  BufferAttribute,
  BufferGeometry,
  InterleavedBufferAttribute,
  Mesh,
  MeshStandardMaterial,
  Object3D,
} from 'three'
import { FloatType, HalfFloatType } from 'three'
import { EXRLoader } from 'three/addons/loaders/EXRLoader.js'
import { type GLTF, GLTFLoader } from 'three/addons/loaders/GLTFLoader.js'
import type { ObjectDescription, SceneDescription, ViewDescription } from '../state/sceneDescription'
import { RendererError } from './errors'
import type {
  HalfPicture,
  ObjectAsset,
  OcclusionFieldAsset,
  RoomAsset,
  SceneAssets,
  ViewAsset,
} from './types'

export type Progress = (loadedBytes: number, totalBytes: number) => void

/**
 * Fetches and decodes all assets of a scene.
 *
 * @param onProgress told bytes loaded and expected in all (0 as long as the server names no sizes).
 * @throws RendererError naming the file and what is wrong with it.
 */
export async function loadSceneAssets(
  scene: SceneDescription,
  onProgress: Progress = () => undefined,
): Promise<SceneAssets> {
  const download = makeDownloader(onProgress)
  const [room, objects, views] = await Promise.all([
    download(scene.room.model_url).then((data) => readRoom(scene.room.model_url, data)),
    Promise.all(scene.objects.map(async (object) => readObject(object, await download(object.model_url)))),
    Promise.all(scene.views.map((view) => loadView(view, download))),
  ])
  return {
    room,
    objects,
    views,
    lights: scene.lights.map((light) => ({
      radiance: light.radiance,
      basisRadiance: light.basis_radiance,
      weight: light.weight,
    })),
    roomTriangles: { positions: room.positions, indices: room.indices, albedo: room.albedo },
  }
}

type Download = (url: string) => Promise<ArrayBuffer>

function makeDownloader(onProgress: Progress): Download {
  let loaded = 0
  let total = 0
  return async (url) => {
    let response: Response
    try {
      response = await fetch(url)
    } catch {
      throw new RendererError(`${url} cannot be fetched: the server does not answer. Is it running?`)
    }
    if (!response.ok || !response.body) {
      throw new RendererError(`${url} cannot be fetched: the server answers ${response.status}.`)
    }
    total += Number(response.headers.get('content-length') ?? 0)
    onProgress(loaded, total)
    const chunks: Uint8Array[] = []
    let size = 0
    const reader = response.body.getReader()
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      chunks.push(part.value)
      size += part.value.byteLength
      loaded += part.value.byteLength
      // A compressed transfer delivers more than its header says.
      onProgress(loaded, Math.max(total, loaded))
    }
    const data = new Uint8Array(size)
    let offset = 0
    for (const chunk of chunks) {
      data.set(chunk, offset)
      offset += chunk.byteLength
    }
    return data.buffer
  }
}

async function parseGlb(url: string, data: ArrayBuffer): Promise<GLTF> {
  try {
    return await new GLTFLoader().parseAsync(data, '')
  } catch (error) {
    throw new RendererError(`${url} is not a readable GLB file: ${String(error)}`)
  }
}

type Attribute = BufferAttribute | InterleavedBufferAttribute

/** Values of an attribute as floats, normalised integers decoded. */
function floatsOf(attribute: Attribute): Float32Array {
  const { count, itemSize } = attribute
  const values = new Float32Array(count * itemSize)
  for (let i = 0; i < count; i++) {
    for (let component = 0; component < itemSize; component++) {
      values[i * itemSize + component] = attribute.getComponent(i, component)
    }
  }
  return values
}

function requireAttribute(url: string, geometry: BufferGeometry, name: string): Float32Array {
  const attribute = geometry.getAttribute(name)
  if (!attribute) {
    throw new RendererError(
      `${url} has no vertex attribute "${name}"; prepare it with \`nearfield prepare\`.`,
    )
  }
  return floatsOf(attribute)
}

function indicesOf(geometry: BufferGeometry): Uint32Array {
  const { index } = geometry
  return index
    ? Uint32Array.from(index.array)
    : Uint32Array.from({ length: geometry.getAttribute('position').count }, (_, i) => i)
}

function isMesh(node: Object3D): node is Mesh<BufferGeometry, MeshStandardMaterial> {
  return (node as Mesh).isMesh
}

function albedoOf(mesh: Mesh<BufferGeometry, MeshStandardMaterial>): [number, number, number] {
  const { r, g, b } = mesh.material.color
  return [r, g, b]
}

/** All primitives of the room as one mesh in world axes. */
export async function readRoom(url: string, data: ArrayBuffer): Promise<RoomAsset> {
  const gltf = await parseGlb(url, data)
  gltf.scene.updateMatrixWorld(true)
  const parts: RoomAsset[] = []
  gltf.scene.traverse((node) => {
    if (!isMesh(node)) return
    const geometry = node.geometry.clone().applyMatrix4(node.matrixWorld)
    if (!geometry.getAttribute('normal')) geometry.computeVertexNormals()
    const positions = requireAttribute(url, geometry, 'position')
    const numVertices = positions.length / 3
    const albedo = albedoOf(node)
    const uv = geometry.getAttribute('uv')
    parts.push({
      positions,
      normals: requireAttribute(url, geometry, 'normal'),
      indices: indicesOf(geometry),
      albedo: Float32Array.from({ length: 3 * numVertices }, (_, i) => albedo[i % 3] ?? 0),
      uv: uv ? floatsOf(uv) : new Float32Array(2 * numVertices),
    })
  })
  if (parts.length === 0) {
    throw new RendererError(`${url} holds no triangles.`)
  }
  return joinParts(parts)
}

function joinParts(parts: readonly RoomAsset[]): RoomAsset {
  const join = (arrays: readonly Float32Array[]): Float32Array => {
    const result = new Float32Array(arrays.reduce((sum, array) => sum + array.length, 0))
    let offset = 0
    for (const array of arrays) {
      result.set(array, offset)
      offset += array.length
    }
    return result
  }
  let firstVertex = 0
  const indices: number[] = []
  for (const part of parts) {
    for (const index of part.indices) indices.push(index + firstVertex)
    firstVertex += part.positions.length / 3
  }
  return {
    positions: join(parts.map((part) => part.positions)),
    normals: join(parts.map((part) => part.normals)),
    albedo: join(parts.map((part) => part.albedo)),
    uv: join(parts.map((part) => part.uv)),
    indices: Uint32Array.from(indices),
  }
}

interface PreparedExtras {
  readonly version: number
  readonly centre: [number, number, number]
  readonly radius: number
  readonly bounceRatio: number
  readonly occlusionField: {
    readonly resolution: [number, number, number]
    readonly boxMin: [number, number, number]
    readonly boxSize: [number, number, number]
    readonly bufferView: number
  } | null
}

/** Of prepared models: prepared_model.py. */
const PREPARED_FORMAT = 2

/** A prepared model (server/ARCHITECTURE.md). */
export async function readObject(object: ObjectDescription, data: ArrayBuffer): Promise<ObjectAsset> {
  const url = object.model_url
  const gltf = await parseGlb(url, data)
  const extras = (gltf.parser.json as { extras?: { nearfield?: PreparedExtras } }).extras?.nearfield
  if (extras?.version !== PREPARED_FORMAT) {
    throw new RendererError(
      `${url} is prepared in format ${extras?.version ?? 'none'}, this page reads ${PREPARED_FORMAT}; run \`nearfield prepare\` again.`,
    )
  }
  const [model, proxy] = await Promise.all([meshOf(url, gltf, 0), meshOf(url, gltf, 1)])
  const { geometry } = model
  return {
    name: object.name,
    albedo: object.albedo,
    worldFromObject: object.world_from_object,
    centre: extras.centre,
    radius: extras.radius,
    positions: requireAttribute(url, geometry, 'position'),
    normals: requireAttribute(url, geometry, 'normal'),
    indices: indicesOf(geometry),
    shadowed: coefficientsOf(url, geometry, '_shadowed'),
    bounce1: coefficientsOf(url, geometry, '_bounce1'),
    bounce2: coefficientsOf(url, geometry, '_bounce2'),
    groundShadow: coefficientsOf(url, geometry, '_ground'),
    bounceRatio: extras.bounceRatio,
    shadowProxy: {
      positions: requireAttribute(url, proxy.geometry, 'position'),
      indices: indicesOf(proxy.geometry),
    },
    occlusionField: await readField(url, gltf, extras.occlusionField),
  }
}

async function meshOf(
  url: string,
  gltf: GLTF,
  index: number,
): Promise<Mesh<BufferGeometry, MeshStandardMaterial>> {
  const found: Mesh<BufferGeometry, MeshStandardMaterial>[] = []
  const root = (await gltf.parser.getDependency('mesh', index)) as Object3D | undefined
  root?.traverse((node) => {
    if (isMesh(node)) found.push(node)
  })
  const mesh = found[0]
  if (!mesh) {
    throw new RendererError(`${url} has no mesh ${index}; prepare it with \`nearfield prepare\`.`)
  }
  return mesh
}

/** Nine per vertex from three attributes of three. */
function coefficientsOf(url: string, geometry: BufferGeometry, name: string): Float32Array {
  const parts = [0, 1, 2].map((part) => requireAttribute(url, geometry, `${name}_${part}`))
  const numVertices = (parts[0]?.length ?? 0) / 3
  const table = new Float32Array(9 * numVertices)
  parts.forEach((values, part) => {
    for (let vertex = 0; vertex < numVertices; vertex++) {
      table.set(values.subarray(3 * vertex, 3 * vertex + 3), 9 * vertex + 3 * part)
    }
  })
  return table
}

async function readField(
  url: string,
  gltf: GLTF,
  field: PreparedExtras['occlusionField'],
): Promise<OcclusionFieldAsset | null> {
  if (!field) return null
  const bytes = (await gltf.parser.getDependency('bufferView', field.bufferView)) as ArrayBuffer
  const [nx, ny, nz] = field.resolution
  if (bytes.byteLength !== 24 * nx * ny * nz) {
    throw new RendererError(
      `${url}: the occlusion field has ${bytes.byteLength} bytes, expected ${24 * nx * ny * nz}; run \`nearfield prepare\` again.`,
    )
  }
  return {
    resolution: field.resolution,
    boxMin: field.boxMin,
    boxSize: field.boxSize,
    coeffs: new Uint16Array(bytes),
  }
}

async function loadView(view: ViewDescription, download: Download): Promise<ViewAsset> {
  const pictures = await Promise.all(
    view.background_urls.map(async (url) => readPicture(url, await download(url), view)),
  )
  return {
    width: view.width,
    height: view.height,
    fx: view.fx,
    fy: view.fy,
    cx: view.cx,
    cy: view.cy,
    worldFromCamera: view.world_from_camera,
    pictures,
  }
}

/** An OpenEXR picture as RGBA half floats, bottom row first. */
export function readPicture(
  url: string,
  data: ArrayBuffer,
  expected: { readonly width: number; readonly height: number },
): HalfPicture {
  let picture: ReturnType<EXRLoader['parse']>
  try {
    picture = new EXRLoader().setDataType(HalfFloatType).parse(data)
  } catch (error) {
    throw new RendererError(`${url} is not a readable OpenEXR picture: ${String(error)}`)
  }
  const { width, height } = picture
  if (width !== expected.width || height !== expected.height) {
    throw new RendererError(
      `${url} has ${width} x ${height} pixels, the view expects ${expected.width} x ${expected.height}.`,
    )
  }
  if (picture.type === FloatType || picture.data?.length !== 4 * width * height) {
    throw new RendererError(`${url} has no red, green and blue channels.`)
  }
  return { width, height, data: picture.data as Uint16Array }
}

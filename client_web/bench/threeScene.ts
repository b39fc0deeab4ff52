/** The scene in three.js: the same meshes, camera and lights, with what the engine offers. */
import {
  AmbientLight,
  BufferAttribute,
  BufferGeometry,
  Color,
  Matrix4,
  Mesh,
  MeshLambertMaterial,
  MeshStandardMaterial,
  PCFShadowMap,
  PerspectiveCamera,
  Scene,
  SpotLight,
  WebGLRenderer,
} from 'three'
import { meanAmbient, SHADOW_MAP_SIZE, SPOT_HALF_ANGLE, spotIntensity } from './lights'
import { type BenchLight, type BenchScene, middleOfObjects, movedVals, objectPose, spotsOf } from './scene'
import type { DrawingOptions } from './variant'

const NEAR = 0.05
const FAR = 30

export type MaterialKind = 'standard' | 'lambert'

/** Axes of OpenCV cameras to those of three.js. */
const FLIP = new Matrix4().makeScale(1, -1, -1)

export class ThreeScene {
  readonly scene = new Scene()
  readonly camera: PerspectiveCamera
  readonly renderer: WebGLRenderer
  readonly canvas: HTMLCanvasElement
  readonly gl: WebGL2RenderingContext
  readonly objects: readonly Mesh[]
  readonly #spots: readonly SpotLight[]
  readonly #bench: BenchScene
  readonly #light: BenchLight

  constructor(bench: BenchScene, light: BenchLight, material: MaterialKind, drawing: DrawingOptions) {
    this.#bench = bench
    this.#light = drawing.lights ? light : { ...light, count: 0 }
    this.renderer = new WebGLRenderer({ antialias: false, powerPreference: 'high-performance' })
    this.canvas = this.renderer.domElement
    this.gl = this.renderer.getContext() as WebGL2RenderingContext
    this.renderer.setSize(bench.lens.width, bench.lens.height, false)
    this.renderer.shadowMap.enabled = drawing.shadows
    this.renderer.shadowMap.type = PCFShadowMap
    this.camera = cameraOf(bench)
    const { room } = bench.assets
    const walls = new Mesh(geometryOf(room, room.albedo), materialOf(material, [1, 1, 1], true))
    this.objects = bench.assets.objects.map(
      (object) => new Mesh(geometryOf(object), materialOf(material, object.albedo, false)),
    )
    for (const mesh of [walls, ...this.objects]) {
      mesh.castShadow = true
      mesh.receiveShadow = true
      this.scene.add(mesh)
    }
    this.#spots = Array.from({ length: this.#light.count }, () => this.#addSpot(drawing.shadows))
    if (drawing.lights) {
      this.scene.add(new AmbientLight(new Color().setRGB(...meanAmbient(light)), 1))
    }
    this.move(0)
  }

  #addSpot(castShadow: boolean): SpotLight {
    const spot = new SpotLight(0xffffff, 1, 0, SPOT_HALF_ANGLE, 0.2, 2)
    spot.castShadow = castShadow
    spot.shadow.mapSize.set(SHADOW_MAP_SIZE, SHADOW_MAP_SIZE)
    spot.shadow.camera.near = NEAR
    spot.shadow.camera.far = FAR
    spot.shadow.bias = -2e-3
    spot.target.position.set(...middleOfObjects(this.#bench))
    this.scene.add(spot, spot.target)
    return spot
  }

  /** Objects and lights of a frame. */
  move(frame: number): void {
    this.objects.forEach((mesh, index) => {
      new Matrix4()
        .fromArray(objectPose(this.#bench, index, frame))
        .transpose()
        .decompose(mesh.position, mesh.quaternion, mesh.scale)
    })
    const middle = middleOfObjects(this.#bench)
    spotsOf(movedVals(this.#light, frame), this.#light.count).forEach((val, slot) => {
      const spot = this.#spots[slot]
      if (!spot) return
      spot.position.set(...val.position)
      const [r, g, b] = spotIntensity(val, middle)
      spot.color.setRGB(r, g, b)
    })
  }

  dispose(): void {
    this.renderer.dispose()
    this.renderer.forceContextLoss()
  }
}

function geometryOf(
  mesh: { positions: Float32Array; normals: Float32Array; indices: Uint32Array },
  colours?: Float32Array,
): BufferGeometry {
  const geometry = new BufferGeometry()
  geometry.setAttribute('position', new BufferAttribute(mesh.positions, 3))
  geometry.setAttribute('normal', new BufferAttribute(mesh.normals, 3))
  if (colours) geometry.setAttribute('color', new BufferAttribute(colours, 3))
  geometry.setIndex(new BufferAttribute(mesh.indices, 1))
  return geometry
}

function materialOf(
  kind: MaterialKind,
  albedo: readonly [number, number, number],
  vertexColors: boolean,
): MeshStandardMaterial | MeshLambertMaterial {
  const color = new Color().setRGB(...albedo)
  return kind === 'standard'
    ? new MeshStandardMaterial({ color, vertexColors, roughness: 1, metalness: 0 })
    : new MeshLambertMaterial({ color, vertexColors })
}

function cameraOf({ view, lens }: BenchScene): PerspectiveCamera {
  const camera = new PerspectiveCamera()
  const left = (-(lens.cx + 0.5) / lens.fx) * NEAR
  const top = ((lens.cy + 0.5) / lens.fy) * NEAR
  const width = (lens.width / lens.fx) * NEAR
  const height = (lens.height / lens.fy) * NEAR
  camera.projectionMatrix.makePerspective(left, left + width, top, top - height, NEAR, FAR)
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert()
  new Matrix4()
    .fromArray([...view.worldFromCamera])
    .transpose()
    .multiply(FLIP)
    .decompose(camera.position, camera.quaternion, camera.scale)
  return camera
}

/** PlayCanvas with clustered lighting: every light casts into one atlas, one tap per light and fragment. */
import {
  AppBase,
  AppOptions,
  CameraComponentSystem,
  Color,
  createGraphicsDevice,
  Entity,
  FILLMODE_NONE,
  GAMMA_SRGB,
  LIGHTFALLOFF_INVERSESQUARED,
  LightComponentSystem,
  Mat4,
  Mesh,
  MeshInstance,
  PRIMITIVE_TRIANGLES,
  Quat,
  RENDERSTYLE_SOLID,
  RESOLUTION_FIXED,
  RenderComponentSystem,
  SEMANTIC_COLOR,
  SHADOW_PCF1_32F,
  SHADOWUPDATE_NONE,
  SHADOWUPDATE_THISFRAME,
  StandardMaterial,
  TONEMAP_LINEAR,
  Vec3,
  type WebglGraphicsDevice,
} from 'playcanvas'
import { LIVE_MAPS_PER_FRAME } from '../src/render/shadowMaps'
import { meanAmbient, SHADOW_MAP_SIZE, SPOT_HALF_ANGLE, spotIntensity } from './lights'
import { type BenchLight, type BenchScene, middleOfObjects, movedVals, objectPose, spotsOf } from './scene'
import type { DrawingOptions, FrameKind, Variant } from './variant'

const DEGREES = 180 / Math.PI
const NEAR = 0.05
const FAR = 30
/** Metres; beyond the room, so that the engine's window function leaves the inverse square law alone. */
const RANGE = 20
/** The engine multiplies inverse-square falloff by 16 and does not divide by pi. */
const INTENSITY_SCALE = 1 / (16 * Math.PI)

export class PlayCanvas implements Variant {
  readonly #app: AppBase
  readonly #bench: BenchScene
  readonly #light: BenchLight
  readonly #objects: readonly Entity[]
  readonly #spots: readonly Entity[]

  static async create(
    scene: BenchScene,
    light: BenchLight,
    exposure: number,
    drawing: DrawingOptions,
  ): Promise<PlayCanvas> {
    const canvas = document.createElement('canvas')
    const device = await createGraphicsDevice(canvas, { deviceTypes: ['webgl2'], antialias: false })
    const options = new AppOptions()
    options.graphicsDevice = device
    options.componentSystems = [RenderComponentSystem, CameraComponentSystem, LightComponentSystem]
    const app = new AppBase(canvas)
    app.init(options)
    app.setCanvasFillMode(FILLMODE_NONE)
    app.setCanvasResolution(RESOLUTION_FIXED, scene.lens.width, scene.lens.height)
    app.autoRender = false
    app.start()
    return new PlayCanvas(app, scene, light, exposure, drawing)
  }

  private constructor(
    app: AppBase,
    bench: BenchScene,
    light: BenchLight,
    exposure: number,
    drawing: DrawingOptions,
  ) {
    this.#app = app
    this.#bench = bench
    this.#light = drawing.lights ? light : { ...light, count: 0 }
    const { scene } = app
    const ambient = drawing.lights ? meanAmbient(light) : [0, 0, 0]
    scene.ambientLight = displayColour(ambient.map((value) => value / Math.PI))
    scene.exposure = exposure
    const perSide = Math.ceil(Math.sqrt(light.count))
    scene.lighting.shadowsEnabled = drawing.shadows
    scene.lighting.shadowType = SHADOW_PCF1_32F
    scene.lighting.atlasSplit = [perSide]
    scene.lighting.shadowAtlasResolution = perSide * SHADOW_MAP_SIZE
    app.root.addChild(this.#camera())
    this.#add(bench.assets.room, bench.assets.room.albedo, materialOf([1, 1, 1], true))
    this.#objects = bench.assets.objects.map((object) =>
      this.#add(object, null, materialOf(object.albedo, false)),
    )
    this.#spots = Array.from({ length: this.#light.count }, () => this.#addSpot(drawing.shadows))
    this.#move(0)
  }

  get canvas(): HTMLCanvasElement {
    return this.#app.graphicsDevice.canvas as HTMLCanvasElement
  }

  get gl(): WebGL2RenderingContext {
    return (this.#app.graphicsDevice as WebglGraphicsDevice).gl
  }

  #camera(): Entity {
    const { view, lens } = this.#bench
    const entity = new Entity('camera')
    entity.addComponent('camera', {
      clearColor: new Color(0, 0, 0),
      nearClip: NEAR,
      farClip: FAR,
      gammaCorrection: GAMMA_SRGB,
      toneMapping: TONEMAP_LINEAR,
    })
    if (entity.camera) {
      entity.camera.calculateProjection = (matrix) => {
        const left = (-(lens.cx + 0.5) / lens.fx) * NEAR
        const top = ((lens.cy + 0.5) / lens.fy) * NEAR
        const right = left + (lens.width / lens.fx) * NEAR
        matrix.setFrustum(left, right, top - (lens.height / lens.fy) * NEAR, top, NEAR, FAR)
      }
    }
    // Axes of OpenCV cameras to those of OpenGL.
    place(entity, [...view.worldFromCamera], new Mat4().setScale(1, -1, -1))
    return entity
  }

  #add(
    data: { positions: Float32Array; normals: Float32Array; indices: Uint32Array },
    colours: Float32Array | null,
    material: StandardMaterial,
  ): Entity {
    const mesh = new Mesh(this.#app.graphicsDevice)
    mesh.setPositions(data.positions)
    mesh.setNormals(data.normals)
    if (colours) mesh.setVertexStream(SEMANTIC_COLOR, colours, 3)
    mesh.setIndices(data.indices)
    mesh.update(PRIMITIVE_TRIANGLES)
    const entity = new Entity()
    entity.addComponent('render', {
      meshInstances: [new MeshInstance(mesh, material)],
      castShadows: true,
      receiveShadows: true,
      renderStyle: RENDERSTYLE_SOLID,
    })
    this.#app.root.addChild(entity)
    return entity
  }

  #addSpot(castShadows: boolean): Entity {
    const entity = new Entity()
    entity.addComponent('light', {
      type: 'spot',
      range: RANGE,
      falloffMode: LIGHTFALLOFF_INVERSESQUARED,
      outerConeAngle: SPOT_HALF_ANGLE * DEGREES,
      innerConeAngle: 0.8 * SPOT_HALF_ANGLE * DEGREES,
      castShadows,
      shadowBias: 0.2,
      normalOffsetBias: 0.05,
    })
    this.#app.root.addChild(entity)
    return entity
  }

  #move(frame: number): void {
    this.#objects.forEach((entity, index) => {
      place(entity, objectPose(this.#bench, index, frame))
    })
    const middle = middleOfObjects(this.#bench)
    spotsOf(movedVals(this.#light, frame), this.#light.count).forEach((val, slot) => {
      const entity = this.#spots[slot]
      if (!entity?.light) return
      entity.setPosition(...val.position)
      entity.lookAt(new Vec3(...middle), Math.abs(val.normal[1]) > 0.9 ? Vec3.RIGHT : Vec3.UP)
      // Spot lights shine along -y.
      entity.rotateLocal(90, 0, 0)
      const intensity = spotIntensity(val, middle).map((value) => INTENSITY_SCALE * value)
      // Below 1 the engine would bend the intensity together with the colour.
      const largest = Math.max(1, ...intensity)
      entity.light.intensity = largest
      entity.light.color = displayColour(intensity.map((value) => value / largest))
    })
  }

  draw(frame: number, kind: FrameKind): void {
    this.#move(frame)
    this.#spots.forEach(({ light }, slot) => {
      const isDue = kind !== 'same maps' || this.#isDue(slot, frame)
      if (light) light.shadowUpdateMode = isDue ? SHADOWUPDATE_THISFRAME : SHADOWUPDATE_NONE
    })
    this.#app.render()
  }

  #isDue(slot: number, frame: number): boolean {
    return (
      Math.floor(slot / LIVE_MAPS_PER_FRAME) === frame % Math.ceil(this.#spots.length / LIVE_MAPS_PER_FRAME)
    )
  }

  dispose(): void {
    const { gl } = this
    this.#app.destroy()
    gl.getExtension('WEBGL_lose_context')?.loseContext()
  }
}

/** The engine takes colours as they are displayed and makes them linear itself. */
function displayColour(linear: readonly number[]): Color {
  const [r = 0, g = 0, b = 0] = linear
  return new Color(r, g, b).gamma()
}

function materialOf(albedo: readonly number[], vertexColours: boolean): StandardMaterial {
  const material = new StandardMaterial()
  material.diffuse = displayColour(albedo)
  material.diffuseVertexColor = vertexColours
  material.specular = new Color(0, 0, 0)
  material.update()
  return material
}

/** @param rowMajor pose. */
function place(entity: Entity, rowMajor: readonly number[], axes?: Mat4): void {
  const m = new Mat4()
  m.set([...rowMajor])
  m.transpose()
  if (axes) m.mul2(m.clone(), axes)
  entity.setLocalPosition(m.getTranslation())
  entity.setLocalRotation(new Quat().setFromMat4(m))
}

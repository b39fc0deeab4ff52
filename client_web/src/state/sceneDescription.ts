/**
 * The JSON of `GET /api/scene`, checked. Field names are those of the wire; the contract is
 * server/nearfield_server/gateway/scene_description.py. Units and frames: protocol/CONVENTIONS.md.
 */
import * as v from 'valibot'

const finite = v.pipe(v.number(), v.finite())
const positive = v.pipe(finite, v.gtValue(0))
const nonNegative = v.pipe(finite, v.minValue(0))
const index = v.pipe(v.number(), v.integer(), v.minValue(0))
const count = v.pipe(v.number(), v.integer(), v.minValue(1))
const vector3 = v.tuple([finite, finite, finite])
const rgb = v.tuple([nonNegative, nonNegative, nonNegative])
const matrix4 = v.pipe(v.array(finite), v.length(16))
/** Only files below assets/ of the same origin: a scene never makes a page load from elsewhere. */
const assetUrl = v.pipe(
  v.string(),
  v.regex(/^assets\/(?:[A-Za-z0-9][A-Za-z0-9._-]*\/){0,2}[A-Za-z0-9][A-Za-z0-9._-]*$/),
)

const bounds = v.object({ minimum: vector3, size: v.tuple([positive, positive, positive]) })

const atlas = v.object({
  width: count,
  height: count,
  texels: index,
  stream_width: v.optional(count, 256),
  stream_height: v.optional(count, 256),
  tile_size: v.optional(count, 32),
})

const room = v.object({
  name: v.string(),
  model_url: assetUrl,
  revision: index,
  atlas,
  bounds,
})

const virtualObject = v.object({
  index,
  name: v.string(),
  model_url: assetUrl,
  albedo: rgb,
  /** Row-major, initial pose. */
  world_from_object: matrix4,
  pose_revision: v.optional(index, 0),
})

const view = v.object({
  index,
  id: v.string(),
  width: count,
  height: count,
  fx: positive,
  fy: positive,
  cx: finite,
  cy: finite,
  /** Row-major, OpenCV camera axes. */
  world_from_camera: matrix4,
  /** One per entry of `lights`, or empty. */
  background_urls: v.optional(v.array(assetUrl), () => []),
})

const light = v.object({
  index,
  name: v.string(),
  radiance: rgb,
  basis_radiance: positive,
  weight: v.optional(nonNegative, 1),
})

const settings = v.object({
  num_vals: v.optional(index, 16),
  light_encoding: v.optional(v.picklist(['compact', 'plain']), 'compact'),
  /** Factor on linear radiance; null = chosen from the background. */
  exposure: v.optional(v.nullable(positive), null),
  stale_after_ms: v.optional(positive, 1000),
})

const sceneDescription = v.object({
  protocol_version: count,
  room,
  objects: v.optional(v.array(virtualObject), () => []),
  views: v.optional(v.array(view), () => []),
  lights: v.optional(v.array(light), () => []),
  settings: v.optional(settings, () => v.parse(settings, {})),
})

export type SceneDescription = v.InferOutput<typeof sceneDescription>
export type ObjectDescription = SceneDescription['objects'][number]
export type ViewDescription = SceneDescription['views'][number]
export type LightDescription = SceneDescription['lights'][number]
export type BoundsDescription = SceneDescription['room']['bounds']

/** The server sent a scene that this page cannot use; the message names the field. */
export class SceneDescriptionError extends Error {
  override readonly name = 'SceneDescriptionError'
}

/**
 * Checks a scene description.
 *
 * @throws SceneDescriptionError naming the first wrong field, what was expected and what was found.
 */
export function parseSceneDescription(json: unknown): SceneDescription {
  const result = v.safeParse(sceneDescription, json)
  if (!result.success) {
    const issue = result.issues[0]
    const where = v.getDotPath(issue) ?? 'the scene description'
    throw new SceneDescriptionError(`Scene description: ${where}: ${issue.message}`)
  }
  checkIndices(result.output)
  return result.output
}

function checkIndices(scene: SceneDescription): void {
  for (const name of ['objects', 'views', 'lights'] as const) {
    scene[name].forEach((entry, position) => {
      if (entry.index !== position) {
        throw new SceneDescriptionError(
          `Scene description: ${name}.${position}.index: expected ${position}, found ${entry.index}`,
        )
      }
    })
  }
  const pictures = Math.max(1, scene.lights.length)
  for (const each of scene.views) {
    const found = each.background_urls.length
    if (found !== 0 && found !== pictures) {
      throw new SceneDescriptionError(
        `Scene description: views.${each.index}.background_urls: expected ${pictures} pictures ` +
          `(one per light), found ${found}`,
      )
    }
  }
}

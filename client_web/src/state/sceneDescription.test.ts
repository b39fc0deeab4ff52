import { describe, expect, it } from 'vitest'
import { parseSceneDescription, SceneDescriptionError } from './sceneDescription'

const identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]

function minimal(): Record<string, unknown> {
  return {
    protocol_version: 1,
    room: {
      name: 'tiny',
      model_url: 'assets/room.glb',
      revision: 7,
      atlas: { width: 64, height: 64, texels: 1000 },
      bounds: { minimum: [0, 0, 0], size: [3, 2, 3] },
    },
    objects: [
      {
        index: 0,
        name: 'bunny',
        model_url: 'assets/objects/bunny.glb',
        albedo: [0.7, 0.7, 0.7],
        world_from_object: identity,
      },
    ],
    views: [
      {
        index: 0,
        id: 'a',
        width: 960,
        height: 540,
        fx: 800,
        fy: 800,
        cx: 479.5,
        cy: 269.5,
        world_from_camera: identity,
        background_urls: ['assets/views/a.exr'],
      },
    ],
    lights: [{ index: 0, name: 'lamp', radiance: [15, 15, 15], basis_radiance: 100 }],
  }
}

function messageOf(json: unknown): string {
  try {
    parseSceneDescription(json)
  } catch (error) {
    expect(error).toBeInstanceOf(SceneDescriptionError)
    return (error as Error).message
  }
  throw new Error('was accepted')
}

describe('parseSceneDescription', () => {
  it('fills the defaults of the server', () => {
    const scene = parseSceneDescription(minimal())
    expect(scene.settings).toEqual({
      num_vals: 16,
      light_encoding: 'compact',
      exposure: null,
      stale_after_ms: 1000,
    })
    expect(scene.lights[0]?.weight).toBe(1)
    expect(scene.objects[0]?.pose_revision).toBe(0)
    expect(scene.room.atlas.tile_size).toBe(32)
  })

  it('accepts fields that a newer server adds', () => {
    expect(parseSceneDescription({ ...minimal(), more: 1 }).room.name).toBe('tiny')
  })

  it('names the wrong field', () => {
    const scene = minimal()
    scene.views = [{ ...(scene.views as object[])[0], fx: -1 }]
    expect(messageOf(scene)).toContain('views.0.fx')
    expect(messageOf('no')).toContain('the scene description')
  })

  it.each([
    'https://elsewhere/x.glb',
    '//elsewhere/x.glb',
    'assets/../x',
    '/assets/x.glb',
    'assets/a/b/c/d.glb',
  ])('refuses the address %s', (url) => {
    const scene = minimal()
    scene.room = { ...(scene.room as object), model_url: url }
    expect(messageOf(scene)).toContain('room.model_url')
  })

  it('refuses indices out of order and missing pictures', () => {
    const scene = minimal()
    scene.lights = [{ index: 1, name: 'lamp', radiance: [1, 1, 1], basis_radiance: 1 }]
    expect(messageOf(scene)).toContain('lights.0.index')
    const other = minimal()
    other.views = [{ ...(other.views as object[])[0], background_urls: ['assets/a.exr', 'assets/b.exr'] }]
    expect(messageOf(other)).toContain('views.0.background_urls')
  })
})

import { Vector3 } from 'three'
import { describe, expect, it } from 'vitest'
import { partsOfPose, poseFromRowMajor } from '../interaction/pose'
import { parseSceneDescription } from '../state/sceneDescription'
import { CameraControl } from './cameraControl'
import { ObjectControl } from './objectControl'

const STANDING = [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 1, 0, 0, 0, 1]
const LOOKING = [1, 0, 0, 2, 0, -1, 0, 1, 0, 0, -1, 3.5, 0, 0, 0, 1]

function scene(numViews: number) {
  return parseSceneDescription({
    protocol_version: 1,
    room: {
      name: 'r',
      model_url: 'assets/room.glb',
      revision: 0,
      atlas: { width: 1, height: 1, texels: 1 },
      bounds: { minimum: [0, 0, 0], size: [4, 2.5, 4] },
    },
    objects: [
      {
        index: 0,
        name: 'o',
        model_url: 'assets/objects/o.glb',
        albedo: [1, 1, 1],
        world_from_object: STANDING,
      },
    ],
    views: Array.from({ length: numViews }, (_, index) => ({
      index,
      id: String(index),
      width: 960,
      height: 540,
      fx: 800,
      fy: 800,
      cx: 479.5,
      cy: 269.5,
      world_from_camera: LOOKING,
    })),
  })
}

const FLOOR = {
  positions: new Float32Array([0, 0, 0, 0, 0, 4, 4, 0, 4, 4, 0, 0]),
  indices: new Uint32Array([0, 1, 2, 0, 2, 3]),
}

describe('CameraControl', () => {
  it('starts the free camera where the tablet stood and keeps it where it was left', () => {
    const camera = new CameraControl(scene(2), null, () => undefined)
    expect(camera.choice()).toEqual({ kind: 'tablet', viewIndex: 0 })
    expect(camera.aspect).toBeCloseTo(960 / 540, 12)
    camera.select('free')
    expect(camera.aspect).toBeNull()
    const expected = poseFromRowMajor(LOOKING)
    camera.worldFromCamera().elements.forEach((value, i) => {
      expect(value).toBeCloseTo(expected.elements[i] as number, 6)
    })
    camera.orbitBy(0.5, 0.1)
    const left = camera.worldFromCamera().clone()
    camera.select(1)
    camera.select('free')
    expect(camera.worldFromCamera()).toEqual(left)
  })

  it('reports a camera once per change', () => {
    const camera = new CameraControl(scene(1), null, () => undefined)
    expect(camera.takeChange()).not.toBeNull()
    expect(camera.takeChange()).toBeNull()
    camera.select('free')
    camera.update()
    expect(camera.takeChange()?.kind).toBe('free')
  })

  it('needs no tablet view', () => {
    const camera = new CameraControl(scene(0), null, () => undefined)
    expect(camera.view).toBe('free')
    const eye = new Vector3().setFromMatrixPosition(camera.worldFromCamera())
    expect(eye.y).toBeCloseTo(1.25, 6)
    const ray = camera.ray(0, 0, 1.5)
    expect(ray.direction.distanceTo(new Vector3(0, 0, -1))).toBeLessThan(1e-6)
  })
})

describe('ObjectControl', () => {
  function control() {
    const log = { changed: 0, sent: 0, selected: [] as number[] }
    let unsettled = false
    const objects = new ObjectControl(scene(1), FLOOR, {
      poseChanged: () => {
        log.changed++
      },
      poseToSend: () => {
        log.sent++
      },
      selected: (objectIndex) => log.selected.push(objectIndex),
      isUnsettled: () => unsettled,
      pick: () => null,
      ray: () => ({ origin: new Vector3(2, 2, 2), direction: new Vector3(0, -1, 0) }),
    })
    return {
      objects,
      log,
      setUnsettled: (value: boolean) => {
        unsettled = value
      },
    }
  }

  const elsewhere = partsOfPose(poseFromRowMajor([1, 0, 0, 3, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1]))

  it('follows the server, but not against a finger or an own message on its way', () => {
    const { objects, log, setUnsettled } = control()
    objects.beginDrag(0, new Vector3(1, 0, 1))
    objects.applyServerPose(0, elsewhere)
    expect(log.changed).toBe(0)
    objects.endDrag()
    setUnsettled(true)
    objects.applyServerPose(0, elsewhere)
    expect(log.changed).toBe(0)
    setUnsettled(false)
    objects.applyServerPose(0, elsewhere)
    expect(log.changed).toBe(1)
    // The same pose again is no change, and what came from the server is not sent back.
    objects.applyServerPose(0, elsewhere)
    expect(log.changed).toBe(1)
    expect(log.sent).toBe(0)
    objects.applyServerPose(7, elsewhere)
    expect(log.changed).toBe(1)
  })

  it('draws and sends every own movement', () => {
    const { objects, log } = control()
    objects.beginDrag(0, new Vector3(1, 0, 1))
    objects.dragTo(0, 0)
    expect(new Vector3().setFromMatrixPosition(objects.pose(0)).toArray()).toEqual([2, 0, 2])
    objects.endDrag()
    objects.rotate(0, 0.2)
    objects.reset(0)
    expect(log).toMatchObject({ changed: 3, sent: 3 })
    expect(objects.pose(0)).toEqual(poseFromRowMajor(STANDING))
  })

  it('ignores keys and buttons while nothing is selected', () => {
    const { objects, log } = control()
    objects.stepSelected(1, 0, poseFromRowMajor(LOOKING), false)
    objects.turnSelected(1)
    objects.reset(-1)
    expect(log.changed).toBe(0)
    objects.select(0)
    objects.select(0)
    expect(log.selected).toEqual([0])
    objects.stepSelected(1, 0, poseFromRowMajor(LOOKING), true)
    expect(objects.pose(0).elements[12]).toBeCloseTo(1.1, 12)
  })
})

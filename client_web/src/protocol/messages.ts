// Atlas tiles and the small messages: control state, status, ack, subscribe, object pose, light weight.

import { DecodeError, EncodeError } from './errors'
import { Reader, require, startMessage } from './framing'
import {
  ACK_BYTES,
  ATLAS_TILE_POSITION_BYTES,
  ATLAS_TILE_SIZE,
  ATLAS_TILES_BYTES,
  CONTROL_STATE_BYTES,
  type Encoding,
  MAX_ATLAS_TILES_PER_SIDE,
  MAX_CAMERAS,
  MAX_LIGHTS,
  MAX_OBJECTS,
  MESSAGE_HEADER_BYTES,
  MessageType,
  OBJECT_POSE_BYTES,
  readAck,
  readAtlasTiles,
  readControlState,
  readObjectPose,
  readSetLightWeight,
  readSetObjectPose,
  readStatus,
  readSubscribe,
  SET_LIGHT_WEIGHT_BYTES,
  SET_OBJECT_POSE_BYTES,
  STATUS_BYTES,
  SUBSCRIBE_BYTES,
  writeAck,
  writeAtlasTiles,
  writeControlState,
  writeObjectPose,
  writeSetLightWeight,
  writeSetObjectPose,
  writeStatus,
  writeSubscribe,
} from './layout.gen'
import { MAX_COORDINATE } from './quantise'

/** How far the norm of a quaternion may be from 1. */
const UNIT_TOLERANCE = 1e-3
const MAX_WEIGHT = 1e6
const TILE_TEXELS = ATLAS_TILE_SIZE * ATLAS_TILE_SIZE

/** Changed tiles of the streamed radiance atlas; upload with UnsignedInt5999Type. */
export interface AtlasTiles {
  readonly sequence: number
  readonly timestampNs: bigint
  readonly roomRevision: number
  /** Size of the whole streamed atlas, texels. */
  readonly width: number
  readonly height: number
  /** Column and row of each tile, in tiles. */
  readonly positions: Uint16Array
  /** 32 x 32 RGB9_E5 texels per tile, row 0 on top. */
  readonly texels: Uint32Array
}

export interface WirePose {
  readonly poseRevision: number
  /** Origin of the object in world axes, metres. */
  readonly position: readonly [number, number, number]
  /** Unit quaternion x, y, z, w that turns object axes into world axes. */
  readonly quaternion: readonly [number, number, number, number]
}

export interface ControlState {
  readonly sequence: number
  readonly revision: number
  readonly lightWeights: readonly number[]
  readonly objectPoses: readonly WirePose[]
}

export interface Status {
  readonly sequence: number
  readonly serverTimeNs: bigint
  /** Seconds; +Infinity if there was no light yet, NaN if not known. */
  readonly lightAge: number
  readonly cameraAges: readonly number[]
  readonly isStale: boolean
}

export type ClientMessage =
  | { readonly type: 'ack'; readonly acknowledgedType: MessageType; readonly acknowledgedSequence: number }
  | { readonly type: 'subscribe'; readonly encoding: Encoding; readonly wantsAtlas: boolean }
  | {
      readonly type: 'setObjectPose'
      readonly objectIndex: number
      readonly position: readonly [number, number, number]
      readonly quaternion: readonly [number, number, number, number]
    }
  | { readonly type: 'setLightWeight'; readonly lightIndex: number; readonly weight: number }

/** Read an atlas message. Throws DecodeError. */
export function decodeAtlasTiles(buffer: ArrayBuffer): AtlasTiles {
  const reader = new Reader(buffer)
  reader.expect(MessageType.ATLAS_TILES)
  const head = reader.record(readAtlasTiles, ATLAS_TILES_BYTES, 'atlas_tiles')
  for (const name of ['width', 'height'] as const) {
    const size = head[name]
    const isWhole =
      size > 0 && size % ATLAS_TILE_SIZE === 0 && size <= ATLAS_TILE_SIZE * MAX_ATLAS_TILES_PER_SIDE
    require(isWhole, name, MESSAGE_HEADER_BYTES + 12, `a multiple of ${ATLAS_TILE_SIZE} in the limits`, size)
  }
  const columns = head.width / ATLAS_TILE_SIZE
  const rows = head.height / ATLAS_TILE_SIZE
  const count = head.num_tiles
  require(count <= columns * rows, 'num_tiles', MESSAGE_HEADER_BYTES + 16, `at most ${columns * rows}`, count)
  const table = reader.take(count * ATLAS_TILE_POSITION_BYTES, 'atlas_tile_position')
  const texels = reader.take(count * TILE_TEXELS * 4, 'texels')
  reader.end()
  const positions = new Uint16Array(2 * count)
  let previous = -1
  for (let i = 0; i < count; i++) {
    const column = reader.view.getUint16(table + 4 * i, true)
    const row = reader.view.getUint16(table + 4 * i + 2, true)
    const order = row * columns + column
    const isValid = column < columns && row < rows && order > previous
    require(isValid, `atlas_tile_position[${i}]`, table +
      4 * i, 'ascending tiles inside', `${column}, ${row}`)
    previous = order
    positions.set([column, row], 2 * i)
  }
  return {
    sequence: reader.sequence,
    timestampNs: head.timestamp_ns,
    roomRevision: head.room_revision,
    width: head.width,
    height: head.height,
    positions,
    // All supported devices are little-endian, as the wire is.
    texels: new Uint32Array(buffer, texels, count * TILE_TEXELS),
  }
}

/** Write an atlas message. */
export function encodeAtlasTiles(tiles: AtlasTiles): ArrayBuffer {
  const count = tiles.positions.length / 2
  const bytes = ATLAS_TILES_BYTES + count * (ATLAS_TILE_POSITION_BYTES + 4 * TILE_TEXELS)
  const view = startMessage(MessageType.ATLAS_TILES, tiles.sequence, bytes)
  writeAtlasTiles(view, MESSAGE_HEADER_BYTES, {
    timestamp_ns: tiles.timestampNs,
    room_revision: tiles.roomRevision,
    width: tiles.width,
    height: tiles.height,
    num_tiles: count,
    reserved: 0,
  })
  const table = MESSAGE_HEADER_BYTES + ATLAS_TILES_BYTES
  new Uint16Array(view.buffer, table, 2 * count).set(tiles.positions)
  new Uint32Array(view.buffer, table + count * ATLAS_TILE_POSITION_BYTES, count * TILE_TEXELS).set(
    tiles.texels,
  )
  return view.buffer as ArrayBuffer
}

function triple(values: ArrayLike<number>): [number, number, number] {
  return [values[0] as number, values[1] as number, values[2] as number]
}

function quadruple(values: ArrayLike<number>): [number, number, number, number] {
  return [...triple(values), values[3] as number]
}

function isPose(position: readonly number[], quaternion: readonly number[]): boolean {
  const isNear = position.every((value) => Math.abs(value) <= MAX_COORDINATE)
  return isNear && Math.abs(Math.hypot(...quaternion) - 1) <= UNIT_TOLERANCE
}

function isWeight(weight: number): boolean {
  return weight >= 0 && weight <= MAX_WEIGHT
}

/** Read a control state. Throws DecodeError. */
export function decodeControlState(buffer: ArrayBuffer): ControlState {
  const reader = new Reader(buffer)
  reader.expect(MessageType.CONTROL_STATE)
  const head = reader.record(readControlState, CONTROL_STATE_BYTES, 'control_state')
  require(head.num_lights <= MAX_LIGHTS, 'num_lights', 20, `at most ${MAX_LIGHTS}`, head.num_lights)
  require(head.num_objects <= MAX_OBJECTS, 'num_objects', 22, `at most ${MAX_OBJECTS}`, head.num_objects)
  const lightWeights: number[] = []
  for (let i = 0; i < head.num_lights; i++) {
    const at = reader.take(4, `light_weights[${i}]`)
    const weight = reader.view.getFloat32(at, true)
    require(isWeight(weight), `light_weights[${i}]`, at, `0 to ${MAX_WEIGHT}`, weight)
    lightWeights.push(weight)
  }
  const objectPoses: WirePose[] = []
  for (let i = 0; i < head.num_objects; i++) {
    const at = reader.offset
    const raw = reader.record(readObjectPose, OBJECT_POSE_BYTES, `object_pose[${i}]`)
    const position = triple(raw.position)
    const quaternion = quadruple(raw.quaternion)
    require(isPose(
      position,
      quaternion,
    ), `object_pose[${i}]`, at, 'a finite pose', `${position}; ${quaternion}`)
    objectPoses.push({ poseRevision: raw.pose_revision, position, quaternion })
  }
  reader.end()
  return { sequence: reader.sequence, revision: head.revision, lightWeights, objectPoses }
}

/** Write a control state. */
export function encodeControlState(state: ControlState): ArrayBuffer {
  const numLights = state.lightWeights.length
  const bytes = CONTROL_STATE_BYTES + 4 * numLights + OBJECT_POSE_BYTES * state.objectPoses.length
  const view = startMessage(MessageType.CONTROL_STATE, state.sequence, bytes)
  writeControlState(view, MESSAGE_HEADER_BYTES, {
    revision: state.revision,
    num_lights: numLights,
    num_objects: state.objectPoses.length,
  })
  const start = MESSAGE_HEADER_BYTES + CONTROL_STATE_BYTES
  state.lightWeights.forEach((weight, i) => {
    view.setFloat32(start + 4 * i, weight, true)
  })
  state.objectPoses.forEach((pose, i) => {
    writeObjectPose(view, start + 4 * numLights + OBJECT_POSE_BYTES * i, {
      pose_revision: pose.poseRevision,
      position: pose.position,
      quaternion: pose.quaternion,
    })
  })
  return view.buffer as ArrayBuffer
}

/** Read a status message. Throws DecodeError. */
export function decodeStatus(buffer: ArrayBuffer): Status {
  const reader = new Reader(buffer)
  reader.expect(MessageType.STATUS)
  const head = reader.record(readStatus, STATUS_BYTES, 'status')
  require(head.num_cameras <= MAX_CAMERAS, 'num_cameras', 28, `at most ${MAX_CAMERAS}`, head.num_cameras)
  require(head.is_stale <= 1, 'is_stale', 30, '0 or 1', head.is_stale)
  require(!(head.light_age < 0), 'light_age', 24, 'at least 0, +infinity or NaN', head.light_age)
  const cameraAges: number[] = []
  for (let i = 0; i < head.num_cameras; i++) {
    const at = reader.take(4, `camera_ages[${i}]`)
    const age = reader.view.getFloat32(at, true)
    require(!(age < 0), `camera_ages[${i}]`, at, 'at least 0, +infinity or NaN', age)
    cameraAges.push(age)
  }
  reader.end()
  return {
    sequence: reader.sequence,
    serverTimeNs: head.server_time_ns,
    lightAge: head.light_age,
    cameraAges,
    isStale: head.is_stale === 1,
  }
}

/** Write a status message. */
export function encodeStatus(status: Status): ArrayBuffer {
  const view = startMessage(MessageType.STATUS, status.sequence, STATUS_BYTES + 4 * status.cameraAges.length)
  writeStatus(view, MESSAGE_HEADER_BYTES, {
    server_time_ns: status.serverTimeNs,
    light_age: status.lightAge,
    num_cameras: status.cameraAges.length,
    is_stale: status.isStale ? 1 : 0,
  })
  status.cameraAges.forEach((age, i) => {
    view.setFloat32(MESSAGE_HEADER_BYTES + STATUS_BYTES + 4 * i, age, true)
  })
  return view.buffer as ArrayBuffer
}

/** Write a message from client to server. Throws EncodeError. */
export function encodeClientMessage(message: ClientMessage, sequence: number): ArrayBuffer {
  const start = MESSAGE_HEADER_BYTES
  let view: DataView
  switch (message.type) {
    case 'ack':
      view = startMessage(MessageType.ACK, sequence, ACK_BYTES)
      writeAck(view, start, {
        acknowledged_sequence: message.acknowledgedSequence,
        acknowledged_type: message.acknowledgedType,
        reserved: 0,
      })
      break
    case 'subscribe':
      view = startMessage(MessageType.SUBSCRIBE, sequence, SUBSCRIBE_BYTES)
      writeSubscribe(view, start, {
        encoding: message.encoding,
        wants_atlas: message.wantsAtlas ? 1 : 0,
        reserved: 0,
      })
      break
    case 'setObjectPose': {
      const { objectIndex, position, quaternion } = message
      if (!isPose(position, quaternion)) {
        throw new EncodeError('set_object_pose', 'a finite pose', `${position}; ${quaternion}`)
      }
      view = startMessage(MessageType.SET_OBJECT_POSE, sequence, SET_OBJECT_POSE_BYTES)
      writeSetObjectPose(view, start, { object_index: objectIndex, reserved: 0, position, quaternion })
      break
    }
    case 'setLightWeight': {
      const { lightIndex, weight } = message
      if (!isWeight(weight)) throw new EncodeError('set_light_weight.weight', `0 to ${MAX_WEIGHT}`, weight)
      view = startMessage(MessageType.SET_LIGHT_WEIGHT, sequence, SET_LIGHT_WEIGHT_BYTES)
      writeSetLightWeight(view, start, { light_index: lightIndex, reserved: 0, weight })
      break
    }
  }
  return view.buffer as ArrayBuffer
}

/** Read a message from client to server, as tools and tests need it. Throws DecodeError. */
export function decodeClientMessage(buffer: ArrayBuffer): { message: ClientMessage; sequence: number } {
  const reader = new Reader(buffer)
  let message: ClientMessage
  switch (reader.messageType) {
    case MessageType.ACK: {
      const raw = reader.record(readAck, ACK_BYTES, 'ack')
      const isKnown = raw.acknowledged_type === 1 || raw.acknowledged_type === 2
      require(isKnown, 'acknowledged_type', 20, '1 or 2', raw.acknowledged_type)
      message = {
        type: 'ack',
        acknowledgedType: raw.acknowledged_type as MessageType,
        acknowledgedSequence: raw.acknowledged_sequence,
      }
      break
    }
    case MessageType.SUBSCRIBE: {
      const raw = reader.record(readSubscribe, SUBSCRIBE_BYTES, 'subscribe')
      require(raw.encoding <= 1 && raw.wants_atlas <= 1, 'subscribe', 16, 'flags 0 or 1', raw.encoding)
      message = { type: 'subscribe', encoding: raw.encoding as Encoding, wantsAtlas: raw.wants_atlas === 1 }
      break
    }
    case MessageType.SET_OBJECT_POSE: {
      const raw = reader.record(readSetObjectPose, SET_OBJECT_POSE_BYTES, 'set_object_pose')
      const position = triple(raw.position)
      const quaternion = quadruple(raw.quaternion)
      require(isPose(
        position,
        quaternion,
      ), 'set_object_pose', 20, 'a finite pose', `${position}; ${quaternion}`)
      message = { type: 'setObjectPose', objectIndex: raw.object_index, position, quaternion }
      break
    }
    case MessageType.SET_LIGHT_WEIGHT: {
      const raw = reader.record(readSetLightWeight, SET_LIGHT_WEIGHT_BYTES, 'set_light_weight')
      require(isWeight(raw.weight), 'set_light_weight.weight', 20, `0 to ${MAX_WEIGHT}`, raw.weight)
      message = { type: 'setLightWeight', lightIndex: raw.light_index, weight: raw.weight }
      break
    }
    default:
      throw new DecodeError('message_type', 6, 'a message from a client', reader.messageType)
  }
  reader.end()
  return { message, sequence: reader.sequence }
}

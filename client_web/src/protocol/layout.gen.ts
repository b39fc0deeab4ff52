// Records on the wire. Generated from protocol/schema.json by generate.py: do not edit.

export const MAGIC = 0x444c464e
export const VERSION = 1
export const SUBPROTOCOL = 'nearfield.v1'
/** Slots in a light packet. */
export const MAX_VALS = 64
/** Virtual objects in a light packet or control state. */
export const MAX_OBJECTS = 256
/** Switchable lights in a control state. */
export const MAX_LIGHTS = 256
/** Cameras in a status message. */
export const MAX_CAMERAS = 64
/** Entries of the section table of a light packet. */
export const MAX_SECTIONS = 16
/** Streamed atlas edge in tiles (2048 texels). */
export const MAX_ATLAS_TILES_PER_SIDE = 64
/** Edge of an atlas tile, texels. */
export const ATLAS_TILE_SIZE = 32
/** Numbers per object: 9 SH coefficients x RGB, coefficient-major. */
export const SH_VALUES = 27
/** Octahedral coordinates are integers -2047..2047 over this (12 bit). */
export const NORMAL_STEPS = 2047
/** Compact positions are integers 0..65535 over this, within the bounds. */
export const POSITION_STEPS = 65535
/** Compact area: 6 bit exponent with this bias, 10 bit mantissa, no sign. */
export const AREA_EXPONENT_BIAS = 40
/** As in OpenGL's RGB9_E5: 5 bit exponent with this bias, three 9 bit mantissas. */
export const RGB9E5_EXPONENT_BIAS = 15
/** Longest message that a client may send. */
export const MAX_CLIENT_MESSAGE_BYTES = 256

/** What a message is. 1..63 go from server to client, 64..127 from client to server. */
export const MessageType = {
  /** virtual area lights and SH of every object */
  LIGHT_PACKET: 1,
  /** changed tiles of the radiance atlas */
  ATLAS_TILES: 2,
  /** light weights and object poses that hold now */
  CONTROL_STATE: 3,
  /** heartbeat: server time and ages */
  STATUS: 4,
  /** a light packet or atlas message has been taken */
  ACK: 64,
  /** what the client wants to receive */
  SUBSCRIBE: 65,
  /** move a virtual object */
  SET_OBJECT_POSE: 66,
  /** dim a switchable light */
  SET_LIGHT_WEIGHT: 67,
} as const
export type MessageType = (typeof MessageType)[keyof typeof MessageType]

/** How the VALs and SH of a light packet are written. */
export const Encoding = {
  /** 32 bytes per VAL, 108 per object (Rohmer et al. 2014, Section 5) */
  PLAIN: 0,
  /** 16 bytes per VAL, 54 per object */
  COMPACT: 1,
} as const
export type Encoding = (typeof Encoding)[keyof typeof Encoding]

/** What a section of a light packet holds. */
export const SectionKind = {
  /** one val_plain or val_compact per slot */
  VALS: 1,
  /** one object_sh_plain or object_sh_compact per object */
  OBJECT_SH: 2,
  /** one object_state per object */
  OBJECT_STATES: 3,
} as const
export type SectionKind = (typeof SectionKind)[keyof typeof SectionKind]

/** Why a websocket was closed; the reason says it in words that can be shown to users. */
export const CloseCode = {
  /** the service restarts; reconnect */
  SHUTTING_DOWN: 1012,
  /** more control messages per second than allowed */
  RATE_LIMITED: 1008,
  /** page and server speak different versions; reload the page */
  VERSION_MISMATCH: 4001,
  /** a message broke the rules of this document */
  MALFORMED_MESSAGE: 4002,
  /** 64 control messages wait to be sent; the client reads too slowly */
  QUEUE_FULL: 4008,
  /** a light packet stayed unacknowledged for too long */
  STALLED: 4009,
  /** as many clients as allowed are connected */
  SERVER_FULL: 4013,
} as const
export type CloseCode = (typeof CloseCode)[keyof typeof CloseCode]

/** Begins every message in both directions. */
export interface MessageHeaderRecord {
  /** uint32: the bytes `NFLD` */
  magic: number
  /** uint16: protocol version, 1 */
  version: number
  /** uint16: MessageType */
  message_type: number
  /** uint32: counts the messages of this type, wrapping; only equality and order matter */
  sequence: number
  /** uint32, bytes: length of the whole message, this header included */
  num_bytes: number
}
export const MESSAGE_HEADER_BYTES = 16
export const MESSAGE_HEADER_OFFSETS = {
  magic: 0,
  version: 4,
  message_type: 6,
  sequence: 8,
  num_bytes: 12,
} as const
export function readMessageHeader(view: DataView, offset: number): MessageHeaderRecord {
  return {
    magic: view.getUint32(offset + 0, true),
    version: view.getUint16(offset + 4, true),
    message_type: view.getUint16(offset + 6, true),
    sequence: view.getUint32(offset + 8, true),
    num_bytes: view.getUint32(offset + 12, true),
  }
}
export function writeMessageHeader(view: DataView, offset: number, record: MessageHeaderRecord): void {
  view.setUint32(offset + 0, record.magic, true)
  view.setUint16(offset + 4, record.version, true)
  view.setUint16(offset + 6, record.message_type, true)
  view.setUint32(offset + 8, record.sequence, true)
  view.setUint32(offset + 12, record.num_bytes, true)
}

/** Follows the message header of LIGHT_PACKET; then the section table, then the sections. */
export interface LightPacketRecord {
  /** uint64, ns: capture time of the oldest camera frame that took part, clock of the server */
  timestamp_ns: bigint
  /** uint32: revision of the room model, as in the scene description */
  room_revision: number
  /** uint8: Encoding */
  encoding: number
  /** uint8: entries of the section table */
  num_sections: number
  /** uint16: 0 */
  reserved: number
  /** float32[3], m: lowest corner of the box that holds all VALs, world axes */
  bounds_min: ArrayLike<number>
  /** float32[3], m: edges of that box, > 0 */
  bounds_size: ArrayLike<number>
}
export const LIGHT_PACKET_BYTES = 40
export const LIGHT_PACKET_OFFSETS = {
  timestamp_ns: 0,
  room_revision: 8,
  encoding: 12,
  num_sections: 13,
  reserved: 14,
  bounds_min: 16,
  bounds_size: 28,
} as const
export function readLightPacket(view: DataView, offset: number): LightPacketRecord {
  return {
    timestamp_ns: view.getBigUint64(offset + 0, true),
    room_revision: view.getUint32(offset + 8, true),
    encoding: view.getUint8(offset + 12),
    num_sections: view.getUint8(offset + 13),
    reserved: view.getUint16(offset + 14, true),
    bounds_min: [view.getFloat32(offset + 16, true), view.getFloat32(offset + 20, true), view.getFloat32(offset + 24, true)],
    bounds_size: [view.getFloat32(offset + 28, true), view.getFloat32(offset + 32, true), view.getFloat32(offset + 36, true)],
  }
}
export function writeLightPacket(view: DataView, offset: number, record: LightPacketRecord): void {
  view.setBigUint64(offset + 0, record.timestamp_ns, true)
  view.setUint32(offset + 8, record.room_revision, true)
  view.setUint8(offset + 12, record.encoding)
  view.setUint8(offset + 13, record.num_sections)
  view.setUint16(offset + 14, record.reserved, true)
  view.setFloat32(offset + 16, record.bounds_min[0] as number, true)
  view.setFloat32(offset + 20, record.bounds_min[1] as number, true)
  view.setFloat32(offset + 24, record.bounds_min[2] as number, true)
  view.setFloat32(offset + 28, record.bounds_size[0] as number, true)
  view.setFloat32(offset + 32, record.bounds_size[1] as number, true)
  view.setFloat32(offset + 36, record.bounds_size[2] as number, true)
}

/** One entry of the section table. Sections follow the table in the same order, each padded with zeros to a multiple of 4 bytes. */
export interface SectionEntryRecord {
  /** uint16: SectionKind */
  kind: number
  /** uint16: elements in the section */
  num_elements: number
  /** uint16, bytes: bytes per element */
  stride: number
  /** int16: radiometric numbers of the section are multiplied by 2 to this power */
  scale_exponent: number
}
export const SECTION_ENTRY_BYTES = 8
export const SECTION_ENTRY_OFFSETS = {
  kind: 0,
  num_elements: 2,
  stride: 4,
  scale_exponent: 6,
} as const
export function readSectionEntry(view: DataView, offset: number): SectionEntryRecord {
  return {
    kind: view.getUint16(offset + 0, true),
    num_elements: view.getUint16(offset + 2, true),
    stride: view.getUint16(offset + 4, true),
    scale_exponent: view.getInt16(offset + 6, true),
  }
}
export function writeSectionEntry(view: DataView, offset: number, record: SectionEntryRecord): void {
  view.setUint16(offset + 0, record.kind, true)
  view.setUint16(offset + 2, record.num_elements, true)
  view.setUint16(offset + 4, record.stride, true)
  view.setInt16(offset + 6, record.scale_exponent, true)
}

/** One virtual area light, PLAIN. */
export interface ValPlainRecord {
  /** float32[3], m: energy-weighted centre, world axes */
  position: ArrayLike<number>
  /** uint32: bits 0..11 and 12..23: octahedral x and y plus 2047; bits 24..31: generation */
  normal: number
  /** float32[3], W/sr: sum of radiance times area, RGB */
  radiant_intensity: ArrayLike<number>
  /** float32, m^2: area of the disc */
  area: number
}
export const VAL_PLAIN_BYTES = 32
export const VAL_PLAIN_OFFSETS = {
  position: 0,
  normal: 12,
  radiant_intensity: 16,
  area: 28,
} as const
export function readValPlain(view: DataView, offset: number): ValPlainRecord {
  return {
    position: [view.getFloat32(offset + 0, true), view.getFloat32(offset + 4, true), view.getFloat32(offset + 8, true)],
    normal: view.getUint32(offset + 12, true),
    radiant_intensity: [view.getFloat32(offset + 16, true), view.getFloat32(offset + 20, true), view.getFloat32(offset + 24, true)],
    area: view.getFloat32(offset + 28, true),
  }
}
export function writeValPlain(view: DataView, offset: number, record: ValPlainRecord): void {
  view.setFloat32(offset + 0, record.position[0] as number, true)
  view.setFloat32(offset + 4, record.position[1] as number, true)
  view.setFloat32(offset + 8, record.position[2] as number, true)
  view.setUint32(offset + 12, record.normal, true)
  view.setFloat32(offset + 16, record.radiant_intensity[0] as number, true)
  view.setFloat32(offset + 20, record.radiant_intensity[1] as number, true)
  view.setFloat32(offset + 24, record.radiant_intensity[2] as number, true)
  view.setFloat32(offset + 28, record.area, true)
}

/** One virtual area light, COMPACT. */
export interface ValCompactRecord {
  /** uint16[3], size / 65535: steps from bounds_min along each axis */
  position: ArrayLike<number>
  /** uint16, m^2: bits 0..9 mantissa, 10..15 exponent with bias 40 */
  area: number
  /** uint32: as in val_plain */
  normal: number
  /** uint32, W/sr: RGB9_E5 times 2^scale_exponent */
  radiant_intensity: number
}
export const VAL_COMPACT_BYTES = 16
export const VAL_COMPACT_OFFSETS = {
  position: 0,
  area: 6,
  normal: 8,
  radiant_intensity: 12,
} as const
export function readValCompact(view: DataView, offset: number): ValCompactRecord {
  return {
    position: [view.getUint16(offset + 0, true), view.getUint16(offset + 2, true), view.getUint16(offset + 4, true)],
    area: view.getUint16(offset + 6, true),
    normal: view.getUint32(offset + 8, true),
    radiant_intensity: view.getUint32(offset + 12, true),
  }
}
export function writeValCompact(view: DataView, offset: number, record: ValCompactRecord): void {
  view.setUint16(offset + 0, record.position[0] as number, true)
  view.setUint16(offset + 2, record.position[1] as number, true)
  view.setUint16(offset + 4, record.position[2] as number, true)
  view.setUint16(offset + 6, record.area, true)
  view.setUint32(offset + 8, record.normal, true)
  view.setUint32(offset + 12, record.radiant_intensity, true)
}

/** SH of the indirect radiance around one object, PLAIN. */
export interface ObjectShPlainRecord {
  /** float32[27], W/m^2: coefficient k, channel c at 3 k + c; world axes */
  sh_coeffs: ArrayLike<number>
}
export const OBJECT_SH_PLAIN_BYTES = 108
export const OBJECT_SH_PLAIN_OFFSETS = {
  sh_coeffs: 0,
} as const
export function readObjectShPlain(view: DataView, offset: number): ObjectShPlainRecord {
  return {
    sh_coeffs: [view.getFloat32(offset + 0, true), view.getFloat32(offset + 4, true), view.getFloat32(offset + 8, true), view.getFloat32(offset + 12, true), view.getFloat32(offset + 16, true), view.getFloat32(offset + 20, true), view.getFloat32(offset + 24, true), view.getFloat32(offset + 28, true), view.getFloat32(offset + 32, true), view.getFloat32(offset + 36, true), view.getFloat32(offset + 40, true), view.getFloat32(offset + 44, true), view.getFloat32(offset + 48, true), view.getFloat32(offset + 52, true), view.getFloat32(offset + 56, true), view.getFloat32(offset + 60, true), view.getFloat32(offset + 64, true), view.getFloat32(offset + 68, true), view.getFloat32(offset + 72, true), view.getFloat32(offset + 76, true), view.getFloat32(offset + 80, true), view.getFloat32(offset + 84, true), view.getFloat32(offset + 88, true), view.getFloat32(offset + 92, true), view.getFloat32(offset + 96, true), view.getFloat32(offset + 100, true), view.getFloat32(offset + 104, true)],
  }
}
export function writeObjectShPlain(view: DataView, offset: number, record: ObjectShPlainRecord): void {
  view.setFloat32(offset + 0, record.sh_coeffs[0] as number, true)
  view.setFloat32(offset + 4, record.sh_coeffs[1] as number, true)
  view.setFloat32(offset + 8, record.sh_coeffs[2] as number, true)
  view.setFloat32(offset + 12, record.sh_coeffs[3] as number, true)
  view.setFloat32(offset + 16, record.sh_coeffs[4] as number, true)
  view.setFloat32(offset + 20, record.sh_coeffs[5] as number, true)
  view.setFloat32(offset + 24, record.sh_coeffs[6] as number, true)
  view.setFloat32(offset + 28, record.sh_coeffs[7] as number, true)
  view.setFloat32(offset + 32, record.sh_coeffs[8] as number, true)
  view.setFloat32(offset + 36, record.sh_coeffs[9] as number, true)
  view.setFloat32(offset + 40, record.sh_coeffs[10] as number, true)
  view.setFloat32(offset + 44, record.sh_coeffs[11] as number, true)
  view.setFloat32(offset + 48, record.sh_coeffs[12] as number, true)
  view.setFloat32(offset + 52, record.sh_coeffs[13] as number, true)
  view.setFloat32(offset + 56, record.sh_coeffs[14] as number, true)
  view.setFloat32(offset + 60, record.sh_coeffs[15] as number, true)
  view.setFloat32(offset + 64, record.sh_coeffs[16] as number, true)
  view.setFloat32(offset + 68, record.sh_coeffs[17] as number, true)
  view.setFloat32(offset + 72, record.sh_coeffs[18] as number, true)
  view.setFloat32(offset + 76, record.sh_coeffs[19] as number, true)
  view.setFloat32(offset + 80, record.sh_coeffs[20] as number, true)
  view.setFloat32(offset + 84, record.sh_coeffs[21] as number, true)
  view.setFloat32(offset + 88, record.sh_coeffs[22] as number, true)
  view.setFloat32(offset + 92, record.sh_coeffs[23] as number, true)
  view.setFloat32(offset + 96, record.sh_coeffs[24] as number, true)
  view.setFloat32(offset + 100, record.sh_coeffs[25] as number, true)
  view.setFloat32(offset + 104, record.sh_coeffs[26] as number, true)
}

/** SH of the indirect radiance around one object, COMPACT. */
export interface ObjectShCompactRecord {
  /** float16[27], W/m^2: as in object_sh_plain, times 2^scale_exponent */
  sh_coeffs: ArrayLike<number>
}
export const OBJECT_SH_COMPACT_BYTES = 54
export const OBJECT_SH_COMPACT_OFFSETS = {
  sh_coeffs: 0,
} as const
export function readObjectShCompact(view: DataView, offset: number): ObjectShCompactRecord {
  return {
    sh_coeffs: [view.getUint16(offset + 0, true), view.getUint16(offset + 2, true), view.getUint16(offset + 4, true), view.getUint16(offset + 6, true), view.getUint16(offset + 8, true), view.getUint16(offset + 10, true), view.getUint16(offset + 12, true), view.getUint16(offset + 14, true), view.getUint16(offset + 16, true), view.getUint16(offset + 18, true), view.getUint16(offset + 20, true), view.getUint16(offset + 22, true), view.getUint16(offset + 24, true), view.getUint16(offset + 26, true), view.getUint16(offset + 28, true), view.getUint16(offset + 30, true), view.getUint16(offset + 32, true), view.getUint16(offset + 34, true), view.getUint16(offset + 36, true), view.getUint16(offset + 38, true), view.getUint16(offset + 40, true), view.getUint16(offset + 42, true), view.getUint16(offset + 44, true), view.getUint16(offset + 46, true), view.getUint16(offset + 48, true), view.getUint16(offset + 50, true), view.getUint16(offset + 52, true)],
  }
}
export function writeObjectShCompact(view: DataView, offset: number, record: ObjectShCompactRecord): void {
  view.setUint16(offset + 0, record.sh_coeffs[0] as number, true)
  view.setUint16(offset + 2, record.sh_coeffs[1] as number, true)
  view.setUint16(offset + 4, record.sh_coeffs[2] as number, true)
  view.setUint16(offset + 6, record.sh_coeffs[3] as number, true)
  view.setUint16(offset + 8, record.sh_coeffs[4] as number, true)
  view.setUint16(offset + 10, record.sh_coeffs[5] as number, true)
  view.setUint16(offset + 12, record.sh_coeffs[6] as number, true)
  view.setUint16(offset + 14, record.sh_coeffs[7] as number, true)
  view.setUint16(offset + 16, record.sh_coeffs[8] as number, true)
  view.setUint16(offset + 18, record.sh_coeffs[9] as number, true)
  view.setUint16(offset + 20, record.sh_coeffs[10] as number, true)
  view.setUint16(offset + 22, record.sh_coeffs[11] as number, true)
  view.setUint16(offset + 24, record.sh_coeffs[12] as number, true)
  view.setUint16(offset + 26, record.sh_coeffs[13] as number, true)
  view.setUint16(offset + 28, record.sh_coeffs[14] as number, true)
  view.setUint16(offset + 30, record.sh_coeffs[15] as number, true)
  view.setUint16(offset + 32, record.sh_coeffs[16] as number, true)
  view.setUint16(offset + 34, record.sh_coeffs[17] as number, true)
  view.setUint16(offset + 36, record.sh_coeffs[18] as number, true)
  view.setUint16(offset + 38, record.sh_coeffs[19] as number, true)
  view.setUint16(offset + 40, record.sh_coeffs[20] as number, true)
  view.setUint16(offset + 42, record.sh_coeffs[21] as number, true)
  view.setUint16(offset + 44, record.sh_coeffs[22] as number, true)
  view.setUint16(offset + 46, record.sh_coeffs[23] as number, true)
  view.setUint16(offset + 48, record.sh_coeffs[24] as number, true)
  view.setUint16(offset + 50, record.sh_coeffs[25] as number, true)
  view.setUint16(offset + 52, record.sh_coeffs[26] as number, true)
}

/** For which pose an object's SH were taken. */
export interface ObjectStateRecord {
  /** uint32: revision of the pose, as in the control state */
  pose_revision: number
}
export const OBJECT_STATE_BYTES = 4
export const OBJECT_STATE_OFFSETS = {
  pose_revision: 0,
} as const
export function readObjectState(view: DataView, offset: number): ObjectStateRecord {
  return {
    pose_revision: view.getUint32(offset + 0, true),
  }
}
export function writeObjectState(view: DataView, offset: number, record: ObjectStateRecord): void {
  view.setUint32(offset + 0, record.pose_revision, true)
}

/** Then num_tiles atlas_tile_position, then as many times 32 x 32 texels (u4, RGB9_E5), row by row, row 0 on top. */
export interface AtlasTilesRecord {
  /** uint64, ns: as in light_packet */
  timestamp_ns: bigint
  /** uint32: as in light_packet */
  room_revision: number
  /** uint16, texels: of the whole streamed atlas, a multiple of 32 */
  width: number
  /** uint16, texels: of the whole streamed atlas, a multiple of 32 */
  height: number
  /** uint16: tiles in this message */
  num_tiles: number
  /** uint16: 0 */
  reserved: number
}
export const ATLAS_TILES_BYTES = 20
export const ATLAS_TILES_OFFSETS = {
  timestamp_ns: 0,
  room_revision: 8,
  width: 12,
  height: 14,
  num_tiles: 16,
  reserved: 18,
} as const
export function readAtlasTiles(view: DataView, offset: number): AtlasTilesRecord {
  return {
    timestamp_ns: view.getBigUint64(offset + 0, true),
    room_revision: view.getUint32(offset + 8, true),
    width: view.getUint16(offset + 12, true),
    height: view.getUint16(offset + 14, true),
    num_tiles: view.getUint16(offset + 16, true),
    reserved: view.getUint16(offset + 18, true),
  }
}
export function writeAtlasTiles(view: DataView, offset: number, record: AtlasTilesRecord): void {
  view.setBigUint64(offset + 0, record.timestamp_ns, true)
  view.setUint32(offset + 8, record.room_revision, true)
  view.setUint16(offset + 12, record.width, true)
  view.setUint16(offset + 14, record.height, true)
  view.setUint16(offset + 16, record.num_tiles, true)
  view.setUint16(offset + 18, record.reserved, true)
}

/** Where a tile lies; positions ascend by row, then column, without repeats. */
export interface AtlasTilePositionRecord {
  /** uint16, tiles: from the left */
  column: number
  /** uint16, tiles: from the top */
  row: number
}
export const ATLAS_TILE_POSITION_BYTES = 4
export const ATLAS_TILE_POSITION_OFFSETS = {
  column: 0,
  row: 2,
} as const
export function readAtlasTilePosition(view: DataView, offset: number): AtlasTilePositionRecord {
  return {
    column: view.getUint16(offset + 0, true),
    row: view.getUint16(offset + 2, true),
  }
}
export function writeAtlasTilePosition(view: DataView, offset: number, record: AtlasTilePositionRecord): void {
  view.setUint16(offset + 0, record.column, true)
  view.setUint16(offset + 2, record.row, true)
}

/** Follows the message header of CONTROL_STATE; then num_lights weights (f4), then num_objects object_pose. */
export interface ControlStateRecord {
  /** uint32: changes whenever anything in this message does */
  revision: number
  /** uint16: switchable lights, as in the scene description */
  num_lights: number
  /** uint16: virtual objects, as in the scene description */
  num_objects: number
}
export const CONTROL_STATE_BYTES = 8
export const CONTROL_STATE_OFFSETS = {
  revision: 0,
  num_lights: 4,
  num_objects: 6,
} as const
export function readControlState(view: DataView, offset: number): ControlStateRecord {
  return {
    revision: view.getUint32(offset + 0, true),
    num_lights: view.getUint16(offset + 4, true),
    num_objects: view.getUint16(offset + 6, true),
  }
}
export function writeControlState(view: DataView, offset: number, record: ControlStateRecord): void {
  view.setUint32(offset + 0, record.revision, true)
  view.setUint16(offset + 4, record.num_lights, true)
  view.setUint16(offset + 6, record.num_objects, true)
}

/** Where a virtual object stands. */
export interface ObjectPoseRecord {
  /** uint32: changes whenever the pose does */
  pose_revision: number
  /** float32[3], m: origin of the object in world axes */
  position: ArrayLike<number>
  /** float32[4]: unit quaternion x, y, z, w that turns object axes into world axes */
  quaternion: ArrayLike<number>
}
export const OBJECT_POSE_BYTES = 32
export const OBJECT_POSE_OFFSETS = {
  pose_revision: 0,
  position: 4,
  quaternion: 16,
} as const
export function readObjectPose(view: DataView, offset: number): ObjectPoseRecord {
  return {
    pose_revision: view.getUint32(offset + 0, true),
    position: [view.getFloat32(offset + 4, true), view.getFloat32(offset + 8, true), view.getFloat32(offset + 12, true)],
    quaternion: [view.getFloat32(offset + 16, true), view.getFloat32(offset + 20, true), view.getFloat32(offset + 24, true), view.getFloat32(offset + 28, true)],
  }
}
export function writeObjectPose(view: DataView, offset: number, record: ObjectPoseRecord): void {
  view.setUint32(offset + 0, record.pose_revision, true)
  view.setFloat32(offset + 4, record.position[0] as number, true)
  view.setFloat32(offset + 8, record.position[1] as number, true)
  view.setFloat32(offset + 12, record.position[2] as number, true)
  view.setFloat32(offset + 16, record.quaternion[0] as number, true)
  view.setFloat32(offset + 20, record.quaternion[1] as number, true)
  view.setFloat32(offset + 24, record.quaternion[2] as number, true)
  view.setFloat32(offset + 28, record.quaternion[3] as number, true)
}

/** Then num_cameras ages (f4, s). An age is +infinity if there was nothing yet, NaN if it is not known. */
export interface StatusRecord {
  /** uint64, ns: now, the clock of timestamp_ns */
  server_time_ns: bigint
  /** float32, s: time since the newest light packet was captured */
  light_age: number
  /** uint16: cameras, in the order of the room file */
  num_cameras: number
  /** uint16: 1 if the light is too old to be trusted, else 0 */
  is_stale: number
}
export const STATUS_BYTES = 16
export const STATUS_OFFSETS = {
  server_time_ns: 0,
  light_age: 8,
  num_cameras: 12,
  is_stale: 14,
} as const
export function readStatus(view: DataView, offset: number): StatusRecord {
  return {
    server_time_ns: view.getBigUint64(offset + 0, true),
    light_age: view.getFloat32(offset + 8, true),
    num_cameras: view.getUint16(offset + 12, true),
    is_stale: view.getUint16(offset + 14, true),
  }
}
export function writeStatus(view: DataView, offset: number, record: StatusRecord): void {
  view.setBigUint64(offset + 0, record.server_time_ns, true)
  view.setFloat32(offset + 8, record.light_age, true)
  view.setUint16(offset + 12, record.num_cameras, true)
  view.setUint16(offset + 14, record.is_stale, true)
}

/** Follows the message header of ACK. */
export interface AckRecord {
  /** uint32: sequence of the message that was taken */
  acknowledged_sequence: number
  /** uint16: LIGHT_PACKET or ATLAS_TILES */
  acknowledged_type: number
  /** uint16: 0 */
  reserved: number
}
export const ACK_BYTES = 8
export const ACK_OFFSETS = {
  acknowledged_sequence: 0,
  acknowledged_type: 4,
  reserved: 6,
} as const
export function readAck(view: DataView, offset: number): AckRecord {
  return {
    acknowledged_sequence: view.getUint32(offset + 0, true),
    acknowledged_type: view.getUint16(offset + 4, true),
    reserved: view.getUint16(offset + 6, true),
  }
}
export function writeAck(view: DataView, offset: number, record: AckRecord): void {
  view.setUint32(offset + 0, record.acknowledged_sequence, true)
  view.setUint16(offset + 4, record.acknowledged_type, true)
  view.setUint16(offset + 6, record.reserved, true)
}

/** Follows the message header of SUBSCRIBE. Before the first one: COMPACT light packets, no atlas. */
export interface SubscribeRecord {
  /** uint8: Encoding of the light packets */
  encoding: number
  /** uint8: 1 to receive atlas tiles, else 0 */
  wants_atlas: number
  /** uint16: 0 */
  reserved: number
}
export const SUBSCRIBE_BYTES = 4
export const SUBSCRIBE_OFFSETS = {
  encoding: 0,
  wants_atlas: 1,
  reserved: 2,
} as const
export function readSubscribe(view: DataView, offset: number): SubscribeRecord {
  return {
    encoding: view.getUint8(offset + 0),
    wants_atlas: view.getUint8(offset + 1),
    reserved: view.getUint16(offset + 2, true),
  }
}
export function writeSubscribe(view: DataView, offset: number, record: SubscribeRecord): void {
  view.setUint8(offset + 0, record.encoding)
  view.setUint8(offset + 1, record.wants_atlas)
  view.setUint16(offset + 2, record.reserved, true)
}

/** Follows the message header of SET_OBJECT_POSE. */
export interface SetObjectPoseRecord {
  /** uint16: position in the scene description */
  object_index: number
  /** uint16: 0 */
  reserved: number
  /** float32[3], m: as in object_pose */
  position: ArrayLike<number>
  /** float32[4]: as in object_pose */
  quaternion: ArrayLike<number>
}
export const SET_OBJECT_POSE_BYTES = 32
export const SET_OBJECT_POSE_OFFSETS = {
  object_index: 0,
  reserved: 2,
  position: 4,
  quaternion: 16,
} as const
export function readSetObjectPose(view: DataView, offset: number): SetObjectPoseRecord {
  return {
    object_index: view.getUint16(offset + 0, true),
    reserved: view.getUint16(offset + 2, true),
    position: [view.getFloat32(offset + 4, true), view.getFloat32(offset + 8, true), view.getFloat32(offset + 12, true)],
    quaternion: [view.getFloat32(offset + 16, true), view.getFloat32(offset + 20, true), view.getFloat32(offset + 24, true), view.getFloat32(offset + 28, true)],
  }
}
export function writeSetObjectPose(view: DataView, offset: number, record: SetObjectPoseRecord): void {
  view.setUint16(offset + 0, record.object_index, true)
  view.setUint16(offset + 2, record.reserved, true)
  view.setFloat32(offset + 4, record.position[0] as number, true)
  view.setFloat32(offset + 8, record.position[1] as number, true)
  view.setFloat32(offset + 12, record.position[2] as number, true)
  view.setFloat32(offset + 16, record.quaternion[0] as number, true)
  view.setFloat32(offset + 20, record.quaternion[1] as number, true)
  view.setFloat32(offset + 24, record.quaternion[2] as number, true)
  view.setFloat32(offset + 28, record.quaternion[3] as number, true)
}

/** Follows the message header of SET_LIGHT_WEIGHT. */
export interface SetLightWeightRecord {
  /** uint16: position in the scene description */
  light_index: number
  /** uint16: 0 */
  reserved: number
  /** float32: factor on the light's radiance, >= 0 */
  weight: number
}
export const SET_LIGHT_WEIGHT_BYTES = 8
export const SET_LIGHT_WEIGHT_OFFSETS = {
  light_index: 0,
  reserved: 2,
  weight: 4,
} as const
export function readSetLightWeight(view: DataView, offset: number): SetLightWeightRecord {
  return {
    light_index: view.getUint16(offset + 0, true),
    reserved: view.getUint16(offset + 2, true),
    weight: view.getFloat32(offset + 4, true),
  }
}
export function writeSetLightWeight(view: DataView, offset: number, record: SetLightWeightRecord): void {
  view.setUint16(offset + 0, record.light_index, true)
  view.setUint16(offset + 2, record.reserved, true)
  view.setFloat32(offset + 4, record.weight, true)
}

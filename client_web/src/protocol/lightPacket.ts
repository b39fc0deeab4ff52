// The light packet: virtual area lights and the SH of every object (Rohmer et al. 2014, Section 5).

import { EncodeError } from './errors'
import { Reader, require, startMessage } from './framing'
import {
  Encoding,
  LIGHT_PACKET_BYTES,
  MAX_OBJECTS,
  MAX_SECTIONS,
  MAX_VALS,
  MESSAGE_HEADER_BYTES,
  MessageType,
  OBJECT_SH_COMPACT_BYTES,
  OBJECT_SH_PLAIN_BYTES,
  OBJECT_STATE_BYTES,
  POSITION_STEPS,
  readLightPacket,
  readSectionEntry,
  readValCompact,
  readValPlain,
  SECTION_ENTRY_BYTES,
  SectionKind,
  SH_VALUES,
  VAL_COMPACT_BYTES,
  VAL_PLAIN_BYTES,
  writeLightPacket,
  writeSectionEntry,
  writeValCompact,
  writeValPlain,
} from './layout.gen'
import {
  AREA_MAX,
  decodeArea,
  decodeHalf,
  decodeNormal,
  decodeRgb9e5,
  encodeArea,
  encodeHalf,
  encodeNormal,
  encodeRgb9e5,
  halfScaleExponent,
  isNormalWord,
  MAX_COORDINATE,
  MAX_RADIOMETRIC,
  MIN_SCALE_EXPONENT_HALF,
  MIN_SCALE_EXPONENT_RGB,
  rgb9e5ScaleExponent,
  scaleByPowerOfTwo,
} from './quantise'

/** Floats per slot in `LightPacket.vals`. */
export const VAL_FLOATS = 16
/** Where a slot's numbers lie: 16 floats, ready for four texels of a data texture. */
export const VAL_POSITION = 0
export const VAL_AREA = 3
export const VAL_NORMAL = 4
export const VAL_RADIANT_INTENSITY = 8

export interface LightPacket {
  readonly sequence: number
  /** Capture time of the oldest camera frame that took part, clock of the server, nanoseconds. */
  readonly timestampNs: bigint
  readonly roomRevision: number
  readonly encoding: Encoding
  readonly numVals: number
  /** 16 floats per slot: position 3 (m), area (m^2), normal 3, 0, radiant intensity 3 (W/sr), 0, 0 0 0 0. */
  readonly vals: Float32Array
  /** Generation of each slot, 0..255. */
  readonly generations: Uint8Array
  readonly numObjects: number
  /** 27 floats per object: coefficient k, channel c at 3 k + c; world axes, W/m^2. */
  readonly objectSh: Float32Array
  /** Pose revision for which each object's SH were taken. */
  readonly objectRevisions: Uint32Array
  /** Lowest corner and edges of the box that holds all VALs, metres. */
  readonly boundsMin: Float32Array
  readonly boundsSize: Float32Array
}

interface Section {
  readonly offset: number
  readonly count: number
  readonly scaleExponent: number
}

function strideOf(kind: number, encoding: Encoding): number {
  if (kind === SectionKind.VALS) return encoding === Encoding.COMPACT ? VAL_COMPACT_BYTES : VAL_PLAIN_BYTES
  if (kind === SectionKind.OBJECT_SH) {
    return encoding === Encoding.COMPACT ? OBJECT_SH_COMPACT_BYTES : OBJECT_SH_PLAIN_BYTES
  }
  return kind === SectionKind.OBJECT_STATES ? OBJECT_STATE_BYTES : 0
}

function exponentRange(kind: number, encoding: Encoding): [number, number] {
  if (encoding === Encoding.PLAIN || kind === SectionKind.OBJECT_STATES) return [0, 0]
  return kind === SectionKind.VALS ? [MIN_SCALE_EXPONENT_RGB, 111] : [MIN_SCALE_EXPONENT_HALF, 112]
}

function readSections(reader: Reader, count: number, encoding: Encoding): Map<number, Section> {
  require(count <= MAX_SECTIONS, 'num_sections', MESSAGE_HEADER_BYTES + 13, `at most ${MAX_SECTIONS}`, count)
  const table = reader.take(count * SECTION_ENTRY_BYTES, 'section_table')
  const sections = new Map<number, Section>()
  for (let i = 0; i < count; i++) {
    const at = table + i * SECTION_ENTRY_BYTES
    const entry = readSectionEntry(reader.view, at)
    const stride = strideOf(entry.kind, encoding)
    // A section that this version does not know adds to the packet and changes nothing else: skip it.
    if (stride > 0) {
      const limit = entry.kind === SectionKind.VALS ? MAX_VALS : MAX_OBJECTS
      const [lowest, highest] = exponentRange(entry.kind, encoding)
      const { scale_exponent: scaleExponent, num_elements: numElements } = entry
      require(!sections.has(entry.kind), 'section_table.kind', at, 'each kind once', entry.kind)
      require(numElements <= limit, 'section_table.num_elements', at + 2, `at most ${limit}`, numElements)
      require(entry.stride === stride, 'section_table.stride', at + 4, stride, entry.stride)
      const isInRange = scaleExponent >= lowest && scaleExponent <= highest
      require(isInRange, 'scale_exponent', at + 6, `${lowest} to ${highest}`, scaleExponent)
      sections.set(entry.kind, { offset: reader.offset, count: numElements, scaleExponent })
    }
    reader.take(entry.num_elements * entry.stride, `section ${entry.kind}`)
    reader.padding()
  }
  reader.end()
  for (const kind of Object.values(SectionKind)) {
    require(sections.has(kind), 'section_table', table, `a section of kind ${kind}`, 'none')
  }
  return sections
}

/** Read a light packet of either encoding into arrays that the renderer can use as they are. Throws DecodeError. */
export function decodeLightPacket(buffer: ArrayBuffer): LightPacket {
  const reader = new Reader(buffer)
  reader.expect(MessageType.LIGHT_PACKET)
  const start = reader.offset
  const head = reader.record(readLightPacket, LIGHT_PACKET_BYTES, 'light_packet')
  require(head.encoding <= 1, 'encoding', start + 12, '0 (plain) or 1 (compact)', head.encoding)
  const encoding = head.encoding as Encoding
  const boundsMin = Float32Array.from(head.bounds_min)
  const boundsSize = Float32Array.from(head.bounds_size)
  const isNear = boundsMin.every((value) => Math.abs(value) <= MAX_COORDINATE)
  require(isNear, 'bounds_min', start + 16, `at most ${MAX_COORDINATE} m`, boundsMin.join())
  const hasSize = boundsSize.every((value) => value > 0 && value <= MAX_COORDINATE)
  require(hasSize, 'bounds_size', start + 28, `> 0, at most ${MAX_COORDINATE} m`, boundsSize.join())
  const sections = readSections(reader, head.num_sections, encoding)
  const valSection = sections.get(SectionKind.VALS) as Section
  const shSection = sections.get(SectionKind.OBJECT_SH) as Section
  const stateSection = sections.get(SectionKind.OBJECT_STATES) as Section
  require(stateSection.count ===
    shSection.count, 'object_states', stateSection.offset, `${shSection.count} entries, one per object`, stateSection.count)
  const vals = new Float32Array(VAL_FLOATS * valSection.count)
  const generations = new Uint8Array(valSection.count)
  const readVal = encoding === Encoding.COMPACT ? readCompactVal : readPlainVal
  for (let i = 0; i < valSection.count; i++) {
    generations[i] = readVal(reader.view, valSection, i, vals, boundsMin, boundsSize)
  }
  const objectRevisions = new Uint32Array(stateSection.count)
  for (let i = 0; i < stateSection.count; i++) {
    objectRevisions[i] = reader.view.getUint32(stateSection.offset + 4 * i, true)
  }
  return {
    sequence: reader.sequence,
    timestampNs: head.timestamp_ns,
    roomRevision: head.room_revision,
    encoding,
    numVals: valSection.count,
    vals,
    generations,
    numObjects: shSection.count,
    objectSh: readObjectSh(reader.view, shSection, encoding),
    objectRevisions,
    boundsMin,
    boundsSize,
  }
}

function readNormal(word: number, offset: number, vals: Float32Array, at: number): number {
  require(isNormalWord(word), 'vals.normal', offset, 'octahedral coordinates of at most 4094', word)
  decodeNormal(word, vals, at + VAL_NORMAL)
  return word >>> 24
}

function readCompactVal(
  view: DataView,
  section: Section,
  i: number,
  vals: Float32Array,
  boundsMin: Float32Array,
  boundsSize: Float32Array,
): number {
  const offset = section.offset + VAL_COMPACT_BYTES * i
  const at = VAL_FLOATS * i
  const raw = readValCompact(view, offset)
  for (let axis = 0; axis < 3; axis++) {
    const fraction = (raw.position[axis] as number) / POSITION_STEPS
    vals[at + axis] = (boundsMin[axis] as number) + fraction * (boundsSize[axis] as number)
  }
  vals[at + VAL_AREA] = decodeArea(raw.area)
  decodeRgb9e5(raw.radiant_intensity, section.scaleExponent, vals, at + VAL_RADIANT_INTENSITY)
  return readNormal(raw.normal, offset + 8, vals, at)
}

function readPlainVal(view: DataView, section: Section, i: number, vals: Float32Array): number {
  const offset = section.offset + VAL_PLAIN_BYTES * i
  const at = VAL_FLOATS * i
  const raw = readValPlain(view, offset)
  for (let axis = 0; axis < 3; axis++) {
    const position = raw.position[axis] as number
    require(Number.isFinite(position), `vals[${i}].position`, offset, 'finite numbers', position)
    vals[at + axis] = position
    const value = raw.radiant_intensity[axis] as number
    const isValid = value >= 0 && value <= MAX_RADIOMETRIC
    require(isValid, `vals[${i}].radiant_intensity`, offset + 16, '0 to 2^126', value)
    vals[at + VAL_RADIANT_INTENSITY + axis] = value
  }
  require(raw.area >= 0 && raw.area <= AREA_MAX, `vals[${i}].area`, offset + 28, `0 to ${AREA_MAX}`, raw.area)
  vals[at + VAL_AREA] = raw.area
  return readNormal(raw.normal, offset + 12, vals, at)
}

function readObjectSh(view: DataView, section: Section, encoding: Encoding): Float32Array {
  const total = SH_VALUES * section.count
  const objectSh = new Float32Array(total)
  for (let i = 0; i < total; i++) {
    if (encoding === Encoding.COMPACT) {
      const half = decodeHalf(view.getUint16(section.offset + 2 * i, true))
      objectSh[i] = scaleByPowerOfTwo(half, section.scaleExponent)
    } else {
      objectSh[i] = view.getFloat32(section.offset + 4 * i, true)
    }
    const value = objectSh[i] as number
    const isValid = Math.abs(value) <= MAX_RADIOMETRIC
    require(isValid, `object_sh[${Math.floor(i / SH_VALUES)}]`, section.offset, 'magnitudes up to 2^126', value)
  }
  return objectSh
}

/** Write a light packet; the inverse of decodeLightPacket, byte for byte. Throws EncodeError. */
export function encodeLightPacket(packet: LightPacket, encoding: Encoding): ArrayBuffer {
  if (packet.numVals > MAX_VALS) throw new EncodeError('vals', `at most ${MAX_VALS}`, packet.numVals)
  if (packet.numObjects > MAX_OBJECTS)
    throw new EncodeError('object_sh', `at most ${MAX_OBJECTS}`, packet.numObjects)
  const isCompact = encoding === Encoding.COMPACT
  let largestIntensity = 0
  for (let i = 0; i < packet.numVals; i++) {
    for (let c = 0; c < 3; c++) {
      const value = packet.vals[VAL_FLOATS * i + VAL_RADIANT_INTENSITY + c] as number
      if (!(value >= 0 && value <= MAX_RADIOMETRIC)) {
        throw new EncodeError(`vals[${i}].radiant_intensity`, 'finite numbers from 0 to 2^126 W/sr', value)
      }
      largestIntensity = Math.max(largestIntensity, value)
    }
  }
  const largestSh = packet.objectSh.reduce((largest, value) => Math.max(largest, Math.abs(value)), 0)
  if (!(largestSh <= MAX_RADIOMETRIC))
    throw new EncodeError('object_sh', 'magnitudes of at most 2^126', largestSh)
  const exponents = isCompact
    ? [rgb9e5ScaleExponent(largestIntensity), halfScaleExponent(largestSh), 0]
    : [0, 0, 0]
  const kinds = [SectionKind.VALS, SectionKind.OBJECT_SH, SectionKind.OBJECT_STATES]
  const counts = [packet.numVals, packet.numObjects, packet.numObjects]
  const sizes = kinds.map((kind, i) => ((counts[i] as number) * strideOf(kind, encoding) + 3) & ~3)
  const bodyBytes = LIGHT_PACKET_BYTES + 3 * SECTION_ENTRY_BYTES + sizes.reduce((sum, size) => sum + size, 0)
  const view = startMessage(MessageType.LIGHT_PACKET, packet.sequence, bodyBytes)
  writeLightPacket(view, MESSAGE_HEADER_BYTES, {
    timestamp_ns: packet.timestampNs,
    room_revision: packet.roomRevision,
    encoding,
    num_sections: 3,
    reserved: 0,
    bounds_min: packet.boundsMin,
    bounds_size: packet.boundsSize,
  })
  const table = MESSAGE_HEADER_BYTES + LIGHT_PACKET_BYTES
  kinds.forEach((kind, i) => {
    writeSectionEntry(view, table + SECTION_ENTRY_BYTES * i, {
      kind,
      num_elements: counts[i] as number,
      stride: strideOf(kind, encoding),
      scale_exponent: exponents[i] as number,
    })
  })
  const valOffset = table + 3 * SECTION_ENTRY_BYTES
  for (let i = 0; i < packet.numVals; i++) {
    if (isCompact) writeCompactVal(view, valOffset + VAL_COMPACT_BYTES * i, packet, i, exponents[0] as number)
    else writePlainVal(view, valOffset + VAL_PLAIN_BYTES * i, packet, i)
  }
  const shOffset = valOffset + (sizes[0] as number)
  packet.objectSh.forEach((value, i) => {
    if (isCompact) {
      const scaled = scaleByPowerOfTwo(value, -(exponents[1] as number))
      view.setUint16(shOffset + 2 * i, encodeHalf(scaled), true)
    } else {
      view.setFloat32(shOffset + 4 * i, value, true)
    }
  })
  const stateOffset = shOffset + (sizes[1] as number)
  packet.objectRevisions.forEach((revision, i) => {
    view.setUint32(stateOffset + 4 * i, revision, true)
  })
  return view.buffer as ArrayBuffer
}

function slotOf(packet: LightPacket, i: number): Float32Array {
  const slot = packet.vals.slice(VAL_FLOATS * i, VAL_FLOATS * (i + 1))
  const intensity = slot.subarray(VAL_RADIANT_INTENSITY, VAL_RADIANT_INTENSITY + 3)
  if (intensity.every((value) => value === 0)) slot.set([...packet.boundsMin, 0, 0, 0, 1, 0, 0, 0, 0])
  return slot
}

function writeCompactVal(
  view: DataView,
  offset: number,
  packet: LightPacket,
  i: number,
  exponent: number,
): void {
  const slot = Array.from(slotOf(packet, i))
  const [x, y, z, area, nx, ny, nz, , red, green, blue] = slot as [
    number,
    number,
    number,
    number,
    number,
    number,
    number,
    number,
    number,
    number,
    number,
  ]
  const generation = packet.generations[i] as number
  const word = encodeRgb9e5(red, green, blue, exponent)
  if ((word & 0x7ffffff) === 0) {
    const normal = encodeNormal(0, 0, 1, generation)
    writeValCompact(view, offset, { position: [0, 0, 0], area: 0, normal, radiant_intensity: 0 })
    return
  }
  const position = [x, y, z].map((value, axis) => {
    const fraction = (value - (packet.boundsMin[axis] as number)) / (packet.boundsSize[axis] as number)
    return Math.min(Math.max(Math.round(fraction * POSITION_STEPS), 0), POSITION_STEPS)
  })
  writeValCompact(view, offset, {
    position,
    area: encodeArea(area),
    normal: encodeNormal(nx, ny, nz, generation),
    radiant_intensity: word,
  })
}

function writePlainVal(view: DataView, offset: number, packet: LightPacket, i: number): void {
  const slot = slotOf(packet, i)
  const normal = Array.from(slot.subarray(VAL_NORMAL, VAL_NORMAL + 3)) as [number, number, number]
  writeValPlain(view, offset, {
    position: slot.subarray(VAL_POSITION, 3),
    normal: encodeNormal(normal[0], normal[1], normal[2], packet.generations[i] as number),
    radiant_intensity: slot.subarray(VAL_RADIANT_INTENSITY, VAL_RADIANT_INTENSITY + 3),
    area: slot[VAL_AREA] as number,
  })
}

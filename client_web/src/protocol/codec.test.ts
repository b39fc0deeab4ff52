import { readdirSync, readFileSync } from 'node:fs'
import * as fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import * as codec from './codec'
import { decodeRgb9e5 } from './quantise'

const FOLDER = new URL('../../../protocol/vectors/', import.meta.url)
// biome-ignore lint/suspicious/noExplicitAny: the JSON differs from message to message and is checked field by field.
type Json = any

function load(name: string): { data: ArrayBuffer; message: string; value: Json } {
  const bytes = readFileSync(new URL(`${name}.bin`, FOLDER))
  const data = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength) as ArrayBuffer
  return { data, ...JSON.parse(readFileSync(new URL(`${name}.json`, FOLDER), 'utf8')) }
}

const names = readdirSync(FOLDER)
  .filter((file) => file.endsWith('.bin'))
  .map((file) => file.slice(0, -4))

const numbers = (texts: string[]): number[] => texts.map(Number)

const checks: Record<string, (data: ArrayBuffer, value: Json) => ArrayBuffer> = {
  light_packet(data, value) {
    const packet = codec.decodeLightPacket(data)
    expect(String(packet.timestampNs)).toBe(value.timestamp_ns)
    expect([packet.sequence, packet.roomRevision].map(String)).toEqual([value.sequence, value.room_revision])
    expect(Array.from(packet.boundsMin)).toEqual(numbers(value.bounds_min))
    expect(Array.from(packet.boundsSize)).toEqual(numbers(value.bounds_size))
    expect(packet.numVals).toBe(value.vals.length)
    value.vals.forEach((val: Json, i: number) => {
      const slot = Array.from(packet.vals.slice(16 * i, 16 * (i + 1)))
      const expected = [
        ...val.position,
        ...val.area,
        ...val.normal,
        '0',
        ...val.radiant_intensity,
        0,
        0,
        0,
        0,
        0,
      ]
      expect(slot).toEqual(numbers(expected))
      expect(packet.generations[i]).toBe(Number(val.generation[0]))
    })
    expect(Array.from(packet.objectSh)).toEqual(numbers(value.object_sh.flat()))
    expect(Array.from(packet.objectRevisions)).toEqual(numbers(value.object_revisions))
    return codec.encodeLightPacket(packet, packet.encoding)
  },
  atlas_tiles(data, value) {
    const tiles = codec.decodeAtlasTiles(data)
    expect([tiles.width, tiles.height]).toEqual(numbers([value.width, value.height]))
    expect(Array.from(tiles.positions)).toEqual(numbers(value.positions))
    const sum = tiles.texels.reduce((total, texel) => total + BigInt(texel), 0n)
    expect(String(sum)).toBe(value.texel_sum)
    value.first_row_radiance.forEach((row: string[], tile: number) => {
      const radiance = new Float32Array(96)
      for (let x = 0; x < 32; x++) decodeRgb9e5(tiles.texels[1024 * tile + x] as number, 0, radiance, 3 * x)
      expect(Array.from(radiance)).toEqual(numbers(row))
    })
    return codec.encodeAtlasTiles(tiles)
  },
  control_state(data, value) {
    const state = codec.decodeControlState(data)
    expect(state.revision).toBe(Number(value.revision))
    expect(state.lightWeights).toEqual(numbers(value.light_weights))
    state.objectPoses.forEach((pose, i) => {
      expect(pose.poseRevision).toBe(Number(value.object_poses[i].pose_revision))
      expect(pose.position).toEqual(numbers(value.object_poses[i].position))
      expect(pose.quaternion).toEqual(numbers(value.object_poses[i].quaternion))
    })
    return codec.encodeControlState(state)
  },
  status(data, value) {
    const status = codec.decodeStatus(data)
    expect(String(status.serverTimeNs)).toBe(value.server_time_ns)
    expect(status.lightAge).toBe(Number(value.light_age))
    expect(status.cameraAges).toEqual(numbers(value.camera_ages))
    expect(status.isStale).toBe(value.is_stale === '1')
    return codec.encodeStatus(status)
  },
  client_message(data, value) {
    const { message, sequence } = codec.decodeClientMessage(data)
    expect(sequence).toBe(Number(value.sequence))
    const fields = Object.fromEntries(
      Object.entries(message).map(([name, field]) => [
        name.replace(/[A-Z]/g, (c) => `_${c.toLowerCase()}`),
        field,
      ]),
    )
    for (const [name, texts] of Object.entries(value)) {
      if (name === 'sequence') continue
      const found = fields[name] as unknown
      if (Array.isArray(texts)) expect(found).toEqual(numbers(texts))
      else expect(Number(found)).toBe(Number(texts))
    }
    return codec.encodeClientMessage(message, sequence)
  },
}

describe('golden vectors', () => {
  it('cover every message', () => {
    expect(new Set(names.map((name) => load(name).message))).toEqual(new Set(Object.keys(checks)))
  })
  it.each(names)('%s decodes and encodes again byte for byte', (name) => {
    const { data, message, value } = load(name)
    const again = (checks[message] as (typeof checks)[string])(data, value)
    expect(Buffer.from(again).toString('hex')).toBe(Buffer.from(data).toString('hex'))
  })
})

describe('hostile bytes', () => {
  const decoders: Record<string, (data: ArrayBuffer) => unknown> = {
    light_packet: codec.decodeLightPacket,
    atlas_tiles: codec.decodeAtlasTiles,
    control_state: codec.decodeControlState,
    status: codec.decodeStatus,
    client_message: codec.decodeClientMessage,
  }
  const attempt = (decode: (data: ArrayBuffer) => unknown, data: ArrayBuffer) => {
    try {
      decode(data)
    } catch (error) {
      expect(error).toBeInstanceOf(codec.DecodeError)
    }
  }
  it.each(names.filter((name) => name !== 'atlas_tiles'))('%s: every truncation is refused', (name) => {
    const { data, message } = load(name)
    const decode = decoders[message] as (data: ArrayBuffer) => unknown
    for (let length = 0; length < data.byteLength; length++) {
      expect(() => decode(data.slice(0, length))).toThrow(codec.DecodeError)
    }
    const longer = new Uint8Array(data.byteLength + 1)
    longer.set(new Uint8Array(data))
    expect(() => decode(longer.buffer)).toThrow(codec.DecodeError)
  })
  it.each(names)('%s: changed bytes end in a value or a DecodeError', (name) => {
    const { data, message } = load(name)
    const changes = fc.array(fc.tuple(fc.nat(Math.min(data.byteLength, 400) - 1), fc.nat(255)), {
      minLength: 1,
      maxLength: 4,
    })
    fc.assert(
      fc.property(changes, (list) => {
        const copy = new Uint8Array(data.slice(0))
        for (const [at, value] of list) copy[at] = value
        attempt(decoders[message] as (data: ArrayBuffer) => unknown, copy.buffer)
      }),
      { numRuns: 200 },
    )
  })
  it('says what was expected and found', () => {
    const { data } = load('light_typical_compact')
    new DataView(data).setUint16(4, 2, true)
    expect(() => codec.decodeLightPacket(data)).toThrow(codec.UnsupportedVersionError)
    expect(() => codec.decodeLightPacket(data)).toThrow('version at byte 4: expected 1, found 2')
  })
})

import { readFileSync } from 'node:fs'
import { describe, expect, it } from 'vitest'
import { decodeClientMessage, encodeStatus, MessageType } from './codec'
import { ClientSession } from './session'

function vector(name: string): ArrayBuffer {
  const bytes = readFileSync(new URL(`../../../protocol/vectors/${name}.bin`, import.meta.url))
  return bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength) as ArrayBuffer
}

const status = encodeStatus({ sequence: 1, serverTimeNs: 0n, lightAge: 0, cameraAges: [], isStale: false })
const sent = (session: ClientSession, nowMs: number) =>
  session.takeOutgoing(nowMs).map((buffer) => decodeClientMessage(buffer).message)

function opened(): ClientSession {
  const session = new ClientSession()
  session.open(0)
  return session
}

describe('ClientSession', () => {
  it('acknowledges light and atlas, and nothing else', () => {
    const session = opened()
    expect(session.receive(vector('light_typical_compact'), 0).type).toBe('light')
    expect(session.receive(vector('atlas_tiles'), 0).type).toBe('atlas')
    expect(session.receive(vector('control_state'), 0).type).toBe('controlState')
    expect(session.receive(vector('status'), 0).type).toBe('status')
    expect(sent(session, 0)).toEqual([
      { type: 'ack', acknowledgedType: MessageType.LIGHT_PACKET, acknowledgedSequence: 2 },
      { type: 'ack', acknowledgedType: MessageType.ATLAS_TILES, acknowledgedSequence: 9 },
    ])
    expect(sent(session, 0)).toEqual([])
  })

  it('acknowledges a light packet that it cannot read, so that the next one comes', () => {
    const session = opened()
    const broken = vector('light_typical_compact')
    new DataView(broken).setUint8(28, 9)
    expect(() => session.receive(broken, 0)).toThrow('encoding at byte 28')
    expect(sent(session, 0)).toHaveLength(1)
  })

  it('sends the newest request per object and light', () => {
    const session = opened()
    for (const weight of [0.1, 0.2, 0.3]) session.request({ type: 'setLightWeight', lightIndex: 0, weight })
    session.request({ type: 'setLightWeight', lightIndex: 1, weight: 1 })
    const messages = sent(session, 0)
    expect(messages).toHaveLength(2)
    expect(messages[0]).toMatchObject({ lightIndex: 0, weight: Math.fround(0.3) })
  })

  it('stays below the rate that the server allows', () => {
    const session = opened()
    let count = 0
    for (let nowMs = 0; nowMs <= 10_000; nowMs += 10) {
      session.receive(status, nowMs)
      for (let lightIndex = 0; lightIndex < 8; lightIndex++) {
        session.request({ type: 'setLightWeight', lightIndex, weight: nowMs })
      }
      count += session.takeOutgoing(nowMs).length
    }
    expect(count).toBeLessThanOrEqual(200)
    expect(count).toBeGreaterThan(170)
  })

  it('keeps requests to itself while the server is silent', () => {
    const session = opened()
    session.request({ type: 'setLightWeight', lightIndex: 0, weight: 1 })
    expect(sent(session, 2000)).toEqual([])
    session.receive(status, 2100)
    expect(sent(session, 2100)).toHaveLength(1)
  })

  it('subscribes again on a new connection', () => {
    const session = opened()
    expect(sent(session, 0)).toEqual([])
    session.wantAtlas(true)
    expect(sent(session, 0)).toEqual([{ type: 'subscribe', encoding: 1, wantsAtlas: true }])
    session.wantAtlas(true)
    expect(sent(session, 0)).toEqual([])
    session.open(10)
    expect(sent(session, 10)).toEqual([{ type: 'subscribe', encoding: 1, wantsAtlas: true }])
    session.wantAtlas(false)
    expect(sent(session, 10)).toEqual([{ type: 'subscribe', encoding: 1, wantsAtlas: false }])
    session.open(20)
    expect(sent(session, 20)).toEqual([])
  })

  it('refuses what only clients send', () => {
    expect(() => opened().receive(vector('ack'), 0)).toThrow('a message from a server')
  })
})

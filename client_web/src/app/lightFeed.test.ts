import { describe, expect, it } from 'vitest'
import type { LightPacket } from '../protocol/codec'
import { LightFeed } from './lightFeed'

function packet(sequence: number, red: number, timestampNs = 0n): LightPacket {
  const vals = new Float32Array(32)
  vals.set([0, 2, 0, 0.04, 0, -1, 0, 0, red, 0, 0])
  return {
    sequence,
    timestampNs,
    roomRevision: 1,
    encoding: 1,
    numVals: 2,
    vals,
    generations: new Uint8Array(2),
    numObjects: 0,
    objectSh: new Float32Array(0),
    objectRevisions: new Uint32Array(0),
    boundsMin: new Float32Array(3),
    boundsSize: new Float32Array([1, 1, 1]),
  }
}

function status(serverMs: number, lightAgeS: number, isStale = false, cameraAges: number[] = []) {
  return {
    sequence: 0,
    serverTimeNs: BigInt(serverMs) * 1_000_000n,
    lightAge: lightAgeS,
    cameraAges,
    isStale,
  }
}

describe('LightFeed', () => {
  it('hands out a light only when it differs from the last one', () => {
    const feed = new LightFeed(1000, { fadeMs: 0 })
    feed.push(packet(1, 5), 100, 0)
    expect(feed.next(0)?.vals[8]).toBe(5)
    expect(feed.next(10)).toBeNull()
    feed.push(packet(2, 5), 100, 20)
    expect(feed.next(20)).toBeNull()
    feed.push(packet(3, 6), 100, 30)
    expect(feed.next(30)?.vals[8]).toBe(6)
    expect(feed.numVals).toBe(1)
    expect(feed.packetBytes).toBe(100)
  })

  it('tells the age on the clock of the server', () => {
    const feed = new LightFeed(1000, { fadeMs: 0 })
    expect(feed.ageMs(0)).toBeNull()
    feed.push(packet(1, 5, 4_950_000_000n), 100, 100)
    feed.observeStatus(status(5000, Number.NaN), 100)
    expect(feed.ageMs(100)).toBeCloseTo(50, 6)
    expect(feed.isStale(100)).toBe(false)
    expect(feed.isStale(1051)).toBe(true)
  })

  it('believes the server when it skips packets that would repeat the light', () => {
    const feed = new LightFeed(1000, { fadeMs: 0 })
    feed.push(packet(1, 5, 0n), 100, 0)
    feed.observeStatus(status(10_000, 0.04), 10_000)
    expect(feed.ageMs(10_000)).toBeCloseTo(40, 6)
    expect(feed.isStale(10_000)).toBe(false)
    feed.observeStatus(status(10_500, 0.04, true), 10_500)
    expect(feed.isStale(10_500)).toBe(true)
  })

  it('tells the age of the newest camera picture while heartbeats come, and counts on when they stop', () => {
    const feed = new LightFeed(5000, { fadeMs: 0 })
    feed.push(packet(1, 5, 0n), 100, 0)
    feed.observeStatus(status(10_000, 0.9, false, [0.3, 0.02, Number.NaN, Number.POSITIVE_INFINITY]), 10_000)
    expect(feed.ageMs(10_000)).toBeCloseTo(20, 6)
    expect(feed.ageMs(11_000)).toBeCloseTo(20, 6)
    expect(feed.ageMs(13_250)).toBeCloseTo(2020, 6)
    expect(feed.isStale(17_000)).toBe(true)
  })

  it('counts updates and stops when none come', () => {
    const feed = new LightFeed(1000, {})
    for (let i = 0; i < 20; i++) {
      feed.push(packet(i, i + 1), 100, 1000 + 50 * i)
    }
    expect(feed.updatesPerSecond(1950)).toBeCloseTo(20, 6)
    expect(feed.updatesPerSecond(9000)).toBe(0)
  })

  it('lets those go on who wait for a light that is shown', async () => {
    const feed = new LightFeed(1000, { fadeMs: 100 })
    feed.push(packet(1, 5), 100, 0)
    feed.next(0)
    let arrived = false
    const waiting = feed.waitFor(2).then(() => {
      arrived = true
    })
    feed.settle()
    feed.push(packet(2, 7), 100, 1000)
    feed.next(1050)
    feed.settle()
    await Promise.resolve()
    expect(arrived).toBe(false)
    feed.next(1100)
    feed.settle()
    await waiting
    expect(arrived).toBe(true)
  })

  it('starts over with a new session', () => {
    const feed = new LightFeed(1000, { fadeMs: 0 })
    feed.push(packet(900, 5), 100, 0)
    feed.reset()
    expect(feed.push(packet(1, 6), 100, 10)).toBe(true)
    expect(feed.next(10)?.vals[8 + 16]).toBe(6)
  })
})

import * as fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import { suitableExposure } from './exposure'
import { FrameLoop, type FrameScheduler } from './frameLoop'
import { FrameTime } from './frameTime'
import { RESOLUTION_STEPS, ResolutionGovernor } from './resolutionGovernor'

class FakeFrames implements FrameScheduler {
  pending = new Map<number, (nowMs: number) => void>()
  #next = 1

  request(callback: (nowMs: number) => void): number {
    this.pending.set(this.#next, callback)
    return this.#next++
  }

  cancel(handle: number): void {
    this.pending.delete(handle)
  }

  tick(nowMs: number): void {
    const callbacks = [...this.pending.values()]
    this.pending.clear()
    for (const callback of callbacks) {
      callback(nowMs)
    }
  }
}

describe('FrameLoop', () => {
  it('rests when nothing is left to draw', () => {
    const frames = new FakeFrames()
    const since: (number | null)[] = []
    let more = true
    const loop = new FrameLoop((_now, sinceLast) => {
      since.push(sinceLast)
      return more
    }, frames)
    expect(frames.pending.size).toBe(0)
    loop.request()
    loop.request()
    expect(frames.pending.size).toBe(1)
    frames.tick(100)
    more = false
    frames.tick(116)
    expect(frames.pending.size).toBe(0)
    loop.request()
    frames.tick(5000)
    // The third frame did not follow directly, so its distance says nothing about speed.
    expect(since).toEqual([null, 16, null])
  })

  it('keeps a request while it is paused', () => {
    const frames = new FakeFrames()
    let drawn = 0
    const loop = new FrameLoop(() => {
      drawn++
      return false
    }, frames)
    loop.request()
    loop.pause()
    loop.request()
    frames.tick(1)
    expect(drawn).toBe(0)
    loop.resume()
    frames.tick(2)
    expect(drawn).toBe(1)
  })
})

describe('ResolutionGovernor', () => {
  function run(governor: ResolutionGovernor, frameMs: number, frames: number): number {
    let changes = 0
    for (let i = 0; i < frames; i++) {
      changes += governor.observe(frameMs) ? 1 : 0
    }
    return changes
  }

  it('settles at the ends for devices that are always slow or always fast', () => {
    const slow = new ResolutionGovernor(2)
    run(slow, 80, 2000)
    expect(slow.scale).toBe(0.5)
    const fast = new ResolutionGovernor(2)
    run(fast, 8, 2000)
    expect(fast.scale).toBe(1.5)
    const coarseScreen = new ResolutionGovernor(1)
    run(coarseScreen, 8, 2000)
    expect(coarseScreen.scale).toBe(1)
  })

  it('does not react to single long frames', () => {
    const governor = new ResolutionGovernor(1)
    for (let i = 0; i < 50; i++) {
      governor.observe(200)
      expect(run(governor, 25, 10)).toBe(0)
    }
  })

  it('hardly ever switches on a device whose time grows with the pixels, and ends at a bearable step', () => {
    fc.assert(
      fc.property(fc.double({ min: 2, max: 120, noNaN: true }), (msAtOne) => {
        const governor = new ResolutionGovernor(2)
        let late = 0
        for (let i = 0; i < 3000; i++) {
          const changed = governor.observe(Math.max(8, msAtOne * governor.scale ** 2))
          late += changed && i > 1000 ? 1 : 0
        }
        expect(late).toBeLessThanOrEqual(2)
        expect(msAtOne * governor.scale ** 2 <= 40 || governor.scale === RESOLUTION_STEPS[0]).toBe(true)
      }),
    )
  })
})

describe('suitableExposure', () => {
  it('brings the 98th percentile of the luminance to 0.9', () => {
    const rgba = new Float32Array(4 * 1000)
    for (let i = 0; i < 1000; i++) {
      rgba.fill(i < 970 ? 0.1 : i < 990 ? 3 : 1000, 4 * i, 4 * i + 3)
    }
    expect(suitableExposure(rgba)).toBeCloseTo(0.3, 6)
  })

  it('scales inversely with the light and leaves black alone', () => {
    const rgba = Float32Array.from({ length: 4000 }, (_, i) => (i % 97) / 97)
    const twice = rgba.map((value) => 2 * value)
    expect((suitableExposure(rgba) ?? 0) / (suitableExposure(twice) ?? 1)).toBeCloseTo(2, 5)
    expect(suitableExposure(new Float32Array(400))).toBeNull()
  })
})

describe('suitableExposure at its limits', () => {
  it('is a finite factor or none, whatever the picture holds, and right from 1e-6 to 6e4', () => {
    const broken = fc.constantFrom(Number.NaN, Number.POSITIVE_INFINITY, Number.NEGATIVE_INFINITY, -1, 0)
    const level = fc.double({ min: Math.log(1e-6), max: Math.log(6e4), noNaN: true }).map(Math.exp)
    fc.assert(
      fc.property(level, fc.array(broken, { maxLength: 3 }), (radiance, spoilt) => {
        const rgba = new Float32Array(4 * 400).fill(radiance)
        spoilt.forEach((value, i) => {
          rgba.fill(value, 44 * i, 44 * i + 3)
        })
        expect((suitableExposure(rgba) ?? 0) * radiance).toBeCloseTo(0.9, 5)
        const all = Float32Array.from({ length: 400 }, (_, i) => spoilt[i % spoilt.length] ?? 0)
        expect(suitableExposure(all)).toBeNull()
      }),
    )
  })
})

describe('FrameTime', () => {
  it('is the median of the newest frames', () => {
    const time = new FrameTime()
    expect(time.medianMs).toBeNull()
    time.observe(7000)
    expect(time.medianMs).toBe(7000)
    for (let i = 0; i < 4; i++) {
      time.observe(16)
    }
    expect(time.medianMs).toBe(16)
    for (let i = 0; i < 8; i++) {
      time.observe(33)
    }
    expect(time.medianMs).toBe(33)
  })
})

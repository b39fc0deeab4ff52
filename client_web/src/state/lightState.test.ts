import * as fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import { type LightFrame, type LightInput, LightState, MAX_SHOWN_VALS } from './lightState'
import { FLOATS_PER_VAL } from './valLayout'

interface Val {
  position?: [number, number, number]
  normal?: [number, number, number]
  intensity: [number, number, number]
  area?: number
  generation?: number
}

function packet(sequence: number, vals: Val[], sh: number[] = []): LightInput {
  return {
    sequence,
    numVals: vals.length,
    vals: new Float32Array(
      vals.flatMap((val) => [
        ...(val.position ?? [1, 2, 3]),
        val.area ?? 0.04,
        ...(val.normal ?? [0, -1, 0]),
        0,
        ...val.intensity,
        ...[0, 0, 0, 0, 0],
      ]),
    ),
    generations: new Uint8Array(vals.map((val) => val.generation ?? 0)),
    objectSh: new Float32Array(sh),
  }
}

function summed(frame: LightFrame): number[] {
  const sum = [0, 0, 0]
  for (let slot = 0; slot < frame.count; slot++) {
    for (let channel = 0; channel < 3; channel++) {
      sum[channel] = (sum[channel] ?? 0) + (frame.vals[slot * FLOATS_PER_VAL + 8 + channel] ?? 0)
    }
  }
  return sum
}

/** Shown lights that are not dark, as [x, y, z, r, g, b]. */
function lit(frame: LightFrame): number[][] {
  const lights: number[][] = []
  for (let slot = 0; slot < frame.count; slot++) {
    const val = frame.vals.subarray(slot * FLOATS_PER_VAL, (slot + 1) * FLOATS_PER_VAL)
    if (val[8] || val[9] || val[10]) {
      lights.push([...val.subarray(0, 3), ...val.subarray(8, 11)])
    }
  }
  return lights
}

const component = fc.integer({ min: 0, max: 1000 }).map((value) => value / 8)
const place = fc.integer({ min: -400, max: 400 }).map((value) => value / 128)
const unit = fc
  .tuple(fc.integer({ min: -9, max: 9 }), fc.integer({ min: -9, max: 9 }), fc.integer({ min: 1, max: 9 }))
  .map(([x, y, z]) => {
    const length = Math.hypot(x, y, z)
    return [x / length, y / length, z / length] as [number, number, number]
  })
const anyVal = fc.record({
  position: fc.tuple(place, place, place),
  normal: unit,
  intensity: fc.tuple(component, component, component),
  area: fc.integer({ min: 1, max: 100 }).map((value) => value / 64),
  generation: fc.integer({ min: 0, max: 2 }),
})
const anyVals = fc.array(anyVal, { minLength: 0, maxLength: MAX_SHOWN_VALS })

describe('LightState', () => {
  it('shows the first packet at once', () => {
    const state = new LightState()
    state.push(packet(5, [{ intensity: [1, 2, 3] }], [1, 2, 3]), 1000)
    const frame = state.sample(1000)
    expect(frame.count).toBe(1)
    expect([...frame.vals.subarray(0, 12)]).toEqual([1, 2, 3, Math.fround(0.04), 0, -1, 0, 0, 1, 2, 3, 0])
    expect([...frame.objectSh]).toEqual([1, 2, 3])
    expect(frame.positionsChanged).toBe(true)
    expect(state.fading).toBe(false)
  })

  it('keeps the newest packet, also when the sequence wraps', () => {
    const state = new LightState({ fadeMs: 0 })
    expect(state.push(packet(0xffffffff, [{ intensity: [1, 1, 1] }]), 0)).toBe(true)
    expect(state.push(packet(0xfffffffe, [{ intensity: [9, 9, 9] }]), 10)).toBe(false)
    expect(state.push(packet(0xffffffff, [{ intensity: [9, 9, 9] }]), 20)).toBe(false)
    expect(state.push(packet(0, [{ intensity: [2, 2, 2] }]), 30)).toBe(true)
    expect(summed(state.sample(30))).toEqual([2, 2, 2])
  })

  it('makes the summed radiant intensity linear in time, with exact ends, whatever changes', () => {
    fc.assert(
      fc.property(anyVals, anyVals, anyVals, fc.double({ min: 0, max: 1, noNaN: true }), (a, b, c, cut) => {
        const state = new LightState({ fadeMs: 100 })
        state.push(packet(1, a), 0)
        state.sample(0)
        state.push(packet(2, b), 1000)
        const interrupted = 1000 + 100 * cut
        const before = summed(state.sample(interrupted))
        state.push(packet(3, c), interrupted)
        const end = summed(state.sample(1e9))
        const wanted = [0, 1, 2].map((channel) =>
          c.reduce((sum, val) => sum + (val.intensity[channel] ?? 0), 0),
        )
        expect(end).toEqual(wanted)
        // A second state stops half-way: the mean of both ends.
        const half = new LightState({ fadeMs: 100 })
        half.push(packet(1, a), 0)
        half.sample(0)
        half.push(packet(2, b), 1000)
        half.sample(interrupted)
        half.push(packet(3, c), interrupted)
        const middle = summed(half.sample(interrupted + 50))
        for (let channel = 0; channel < 3; channel++) {
          const mean = ((before[channel] ?? 0) + (end[channel] ?? 0)) / 2
          expect(middle[channel]).toBeCloseTo(mean, 2)
        }
      }),
      { numRuns: 150 },
    )
  })

  it('never slides a light whose generation changed', () => {
    const state = new LightState({ fadeMs: 100 })
    state.push(packet(1, [{ position: [0, 0, 0], intensity: [4, 4, 4], generation: 1 }]), 0)
    state.sample(0)
    state.push(packet(2, [{ position: [3, 0, 0], intensity: [8, 8, 8], generation: 2 }]), 1000)
    expect(lit(state.sample(1025))).toEqual([
      [0, 0, 0, 3, 3, 3],
      [3, 0, 0, 2, 2, 2],
    ])
    const end = state.sample(1100)
    expect(lit(end)).toEqual([[3, 0, 0, 8, 8, 8]])
  })

  it('redraws one shadow map for a light that was replaced, none while it fades', () => {
    const state = new LightState({ fadeMs: 100 })
    state.push(packet(1, [{ position: [0, 0, 0], intensity: [4, 4, 4] }]), 0)
    state.sample(0)
    state.push(packet(2, [{ position: [3, 0, 0], intensity: [8, 8, 8], generation: 1 }]), 1000)
    expect([...state.sample(1025).changedSlots.subarray(0, 3)]).toEqual([0, 1, 0])
    for (const time of [1050, 1100, 1200]) {
      const frame = state.sample(time)
      expect(frame.positionsChanged).toBe(false)
      expect(frame.changedSlots.some((flag) => flag !== 0)).toBe(false)
    }
  })

  it('tolerates trembling, but not drifting', () => {
    const state = new LightState({ fadeMs: 0 })
    const show = (sequence: number, x: number) => {
      state.push(packet(sequence, [{ position: [x, 0, 0], intensity: [1, 1, 1] }]), sequence)
      const frame = state.sample(sequence)
      expect(frame.vals[0]).toBe(Math.fround(x))
      return frame.positionsChanged
    }
    expect(show(1, 1)).toBe(true)
    expect([2, 3, 4, 5].map((sequence) => show(sequence, 1 + 0.0008 * (sequence % 2)))).toEqual([
      false,
      false,
      false,
      false,
    ])
    const drift = Array.from({ length: 50 }, (_, i) => show(6 + i, 1 + 0.0004 * i))
    // 19.6 mm in steps of 0.4 mm: reported whenever more than 1 mm has gathered.
    expect(drift.filter(Boolean).length).toBe(16)
  })

  it('reports every movement when asked to be exact', () => {
    const state = new LightState({ fadeMs: 0, placeTolerance: 0 })
    state.push(packet(1, [{ position: [1, 0, 0], intensity: [1, 1, 1] }]), 1)
    state.sample(1)
    state.push(packet(2, [{ position: [1.00001, 0, 0], intensity: [1, 1, 1] }]), 2)
    expect(state.sample(2).positionsChanged).toBe(true)
  })

  it('moves a light that stayed the same along a straight line with a unit normal', () => {
    const state = new LightState({ fadeMs: 100 })
    state.push(packet(1, [{ position: [0, 0, 0], normal: [0, 0, 1], intensity: [4, 4, 4] }]), 0)
    state.sample(0)
    state.push(packet(2, [{ position: [2, 4, 0], normal: [1, 0, 0], intensity: [4, 4, 4] }]), 1000)
    const vals = state.sample(1050).vals
    expect([...vals.subarray(0, 3)]).toEqual([1, 2, 0])
    expect(vals[4]).toBeCloseTo(Math.SQRT1_2, 6)
    expect(vals[6]).toBeCloseTo(Math.SQRT1_2, 6)
    expect(state.sample(1050).positionsChanged).toBe(false)
  })

  it('lets a lamp that goes on or off stand still', () => {
    const state = new LightState({ fadeMs: 100 })
    state.push(packet(1, [{ position: [0, 0, 0], intensity: [0, 0, 0] }]), 0)
    state.sample(0)
    state.push(packet(2, [{ position: [2, 0, 0], intensity: [4, 4, 4] }]), 1000)
    expect(lit(state.sample(1050))).toEqual([[2, 0, 0, 2, 2, 2]])
    state.sample(1100)
    state.push(packet(3, [{ position: [0, 0, 0], intensity: [0, 0, 0] }]), 2000)
    expect(lit(state.sample(2050))).toEqual([[2, 0, 0, 2, 2, 2]])
    expect(lit(state.sample(2100))).toEqual([])
  })

  it('changes nothing when the packet changes nothing', () => {
    fc.assert(
      fc.property(anyVals, (vals) => {
        const state = new LightState({ fadeMs: 100 })
        state.push(packet(1, vals, [1, 2, 3]), 0)
        const revision = state.sample(0).revision
        state.push(packet(2, vals, [1, 2, 3]), 500)
        expect(state.fading).toBe(false)
        const frame = state.sample(550)
        expect(frame.revision).toBe(revision)
        expect(frame.positionsChanged).toBe(false)
        expect(state.sequence).toBe(2)
      }),
      { numRuns: 50 },
    )
  })

  it('mixes the indirect light linearly', () => {
    const state = new LightState({ fadeMs: 100 })
    state.push(packet(1, [], [0, 8]), 0)
    state.sample(0)
    state.push(packet(2, [], [4, 0]), 1000)
    expect([...state.sample(1025).objectSh]).toEqual([1, 6])
    expect([...state.sample(1100).objectSh]).toEqual([4, 0])
  })

  it('fades within the time between updates, 80 to 250 ms', () => {
    const state = new LightState()
    for (let i = 0; i < 60; i++) {
      state.push(packet(i, [{ intensity: [i + 1, 0, 0] }]), 100_000 + i * 120)
      state.sample(100_000 + i * 120)
    }
    expect(state.updateIntervalMs).toBeCloseTo(120, 6)
    const last = 100_000 + 59 * 120
    state.sample(last + 119)
    expect(state.fading).toBe(true)
    state.sample(last + 121)
    expect(state.fading).toBe(false)
  })

  it('switches at once when asked to (evaluation)', () => {
    const state = new LightState({ fadeMs: 0 })
    state.push(packet(1, [{ intensity: [1, 1, 1] }]), 0)
    state.sample(0)
    state.push(packet(2, [{ intensity: [2, 2, 2], generation: 1 }]), 10)
    expect(lit(state.sample(10))).toEqual([[1, 2, 3, 2, 2, 2]])
  })

  it('takes any sequence after a reset and trusts no slot', () => {
    const state = new LightState({ fadeMs: 100 })
    state.push(packet(50, [{ position: [0, 0, 0], intensity: [4, 4, 4] }]), 0)
    state.sample(0)
    state.reset()
    expect(state.push(packet(1, [{ position: [3, 0, 0], intensity: [4, 4, 4] }]), 1000)).toBe(true)
    expect(lit(state.sample(1050))).toEqual([
      [0, 0, 0, 2, 2, 2],
      [3, 0, 0, 2, 2, 2],
    ])
    expect(lit(state.sample(1100))).toEqual([[3, 0, 0, 4, 4, 4]])
  })

  it('never goes back, whatever the clocks say', () => {
    const time = fc.oneof(
      fc.double({ min: 0, max: 400, noNaN: true }),
      fc.constantFrom(Number.NaN, Number.POSITIVE_INFINITY, Number.NEGATIVE_INFINITY, -5),
    )
    fc.assert(
      fc.property(fc.array(time, { minLength: 1, maxLength: 30 }), (times) => {
        const state = new LightState({ fadeMs: 100 })
        state.push(packet(1, [{ intensity: [1, 0, 8] }], [2, -3]), 0)
        state.sample(0)
        state.push(packet(2, [{ intensity: [4, 1, 0] }], [-2, 5]), 50)
        let last = [1, 0, 8, 2, -3]
        for (const now of times) {
          const frame = state.sample(now)
          const shown = [...frame.vals.subarray(8, 11), ...frame.objectSh]
          const rises = [true, true, false, false, true]
          shown.forEach((value, i) => {
            expect(rises[i] ? value >= (last[i] ?? 0) : value <= (last[i] ?? 0)).toBe(true)
          })
          last = shown
        }
        expect([...state.sample(500).vals.subarray(8, 11)]).toEqual([4, 1, 0])
      }),
    )
  })

  it('starts the next fade from what is shown, also when a packet is stamped before the last frame', () => {
    const state = new LightState({ fadeMs: 100 })
    state.push(packet(1, [{ intensity: [0, 0, 1] }]), 0)
    state.sample(0)
    state.push(packet(2, [{ intensity: [8, 0, 1] }]), 1000)
    expect(state.sample(1050).vals[8]).toBe(4)
    state.push(packet(3, [{ intensity: [8, 0, 2] }]), 1040)
    expect(state.sample(1045).vals[8]).toBe(4)
    expect(state.sample(1100).vals[8]).toBe(6)
  })

  it('holds for zero, denormal and huge light: exact ends, nothing beyond them, always finite', () => {
    const extreme = fc.constantFrom(0, 2 ** -149, 1e-40, 1e-30, 1, 65504, 1e30, 2 ** 126)
    const lamp = fc.tuple(extreme, extreme, extreme)
    fc.assert(
      fc.property(lamp, lamp, fc.array(fc.double({ min: 0, max: 1, noNaN: true })), (a, b, cuts) => {
        const state = new LightState({ fadeMs: 100 })
        state.push(packet(1, [{ intensity: a }], [...a, -a[0]]), 0)
        state.sample(0)
        state.push(packet(2, [{ intensity: b }], [...b, b[1]]), 1000)
        for (const cut of cuts) {
          const frame = state.sample(1000 + 100 * cut)
          a.forEach((start, i) => {
            const [low, high] = [Math.min(start, b[i] ?? 0), Math.max(start, b[i] ?? 0)].map(Math.fround)
            for (const value of [summed(frame)[i] ?? 0, frame.objectSh[i] ?? 0]) {
              expect(value).toBeGreaterThanOrEqual(low ?? 0)
              expect(value).toBeLessThanOrEqual(high ?? 0)
            }
          })
          expect(frame.vals.every(Number.isFinite)).toBe(true)
          expect(frame.objectSh.every(Number.isFinite)).toBe(true)
        }
        expect(summed(state.sample(1100))).toEqual(b.map(Math.fround))
      }),
    )
  })

  it('shows what a fresh client shows after thousands of updates with lamps coming and going', () => {
    let seed = 1
    const random = () => {
      seed = (Math.imul(seed, 1103515245) + 12345) >>> 0
      return seed / 2 ** 32
    }
    const state = new LightState()
    const generation = new Uint8Array(16)
    let vals: Val[] = []
    for (let i = 0; i < 5000; i++) {
      vals = Array.from({ length: 16 }, (_, slot) => {
        generation[slot] = (generation[slot] ?? 0) + (random() < 0.1 ? 1 : 0)
        const on = random() < 0.8
        return {
          position: [random(), random(), slot],
          intensity: on ? [random(), random(), 1] : [0, 0, 0],
          generation: generation[slot] ?? 0,
        }
      })
      state.push(packet((0xfffff000 + i) >>> 0, vals, [random()]), 33 * i)
      state.sample(33 * i + 16)
    }
    const end = lit(state.sample(1e9))
    const fresh = new LightState()
    fresh.push(packet(1, vals, []), 0)
    const order = (a: number[], b: number[]) => (a[2] ?? 0) - (b[2] ?? 0)
    expect(end.sort(order)).toEqual(lit(fresh.sample(0)).sort(order))
    expect(state.fading).toBe(false)
  })

  it('does not allocate frames', () => {
    const state = new LightState({ fadeMs: 100 })
    state.push(packet(1, [{ intensity: [1, 1, 1] }], [1]), 0)
    const frame = state.sample(0)
    const { vals, objectSh, changedSlots } = frame
    state.push(packet(2, [{ intensity: [2, 1, 1] }], [2]), 100)
    expect(state.sample(150)).toBe(frame)
    expect(frame.vals).toBe(vals)
    expect(frame.objectSh).toBe(objectSh)
    expect(frame.changedSlots).toBe(changedSlots)
  })

  it('refuses more lights than can be shown', () => {
    const vals = Array.from({ length: 65 }, () => ({ intensity: [1, 1, 1] as [number, number, number] }))
    expect(() => new LightState().push(packet(1, vals), 0)).toThrow(/at most 64/)
  })
})

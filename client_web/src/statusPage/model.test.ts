import fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import { exposureTime } from '../ui/format'
import { linePath, SPAN_S, scaleTop } from './chart'
import { increments, parseHistory, parseStatus } from './model'

const camera = {
  id: 'cam0',
  index: 0,
  process: 'cam0',
  state: 'lost',
  fault: 'no frame for 0.6 s',
  warnings: ['receive buffer too small'],
  kind: 'aravis',
  model: null,
  frame_rate: 9.9,
  frames: 12,
  frames_lost: null,
  frames_broken: 3,
  exposure_s: [0.01, 0.0001],
  gain: 1,
  saturated_share: 0.02,
  age_s: 3.5,
  temperature_c: null,
  reconnects: 2,
  restarts: 0,
}

const status = {
  clients: 2,
  max_clients: 32,
  light: { age_s: 3.5, is_stale: true, num_bytes: 452 },
  cameras: [camera],
  processes: {
    supervisor: {
      uptime_s: 60,
      children: {
        cam0: { pid: 7, restarts: 0, last_fault: '', fault: null },
        gateway: { pid: null, restarts: 2, last_fault: 'killed by SIGKILL', fault: null },
      },
    },
    illumination: { backend: 'cpu', light_age_s: 0.25, phase: 'running' },
    cam0: { phase: 'running' },
  },
}

describe('status', () => {
  it('keeps what a camera does not tell apart from 0', () => {
    const parsed = parseStatus(status)
    expect(parsed?.cameras[0]).toMatchObject({
      state: 'lost',
      framesLost: null,
      framesBroken: 3,
      exposuresS: [0.01, 0.0001],
      fault: 'no frame for 0.6 s',
    })
    expect(parsed).toMatchObject({
      isStale: true,
      lightAgeS: 0.25,
      backend: 'cpu',
      uptimeS: 60,
      recording: null,
    })
  })

  it('tells a process that is away, and why', () => {
    const processes = parseStatus(status)?.processes
    expect(processes?.find(({ name }) => name === 'gateway')).toEqual({
      name: 'gateway',
      phase: 'away',
      restarts: 2,
      words: 'killed by SIGKILL',
      isWell: false,
    })
    expect(processes?.find(({ name }) => name === 'cam0')).toMatchObject({ phase: 'running', isWell: true })
  })

  it('is null for anything that is no status', () => {
    fc.assert(
      fc.property(fc.jsonValue(), (json) => parseStatus(json) === null && parseHistory({ x: json }) === null),
    )
    expect(parseStatus({ ...status, cameras: [{ ...camera, state: 'asleep' }] })).toBeNull()
    expect(parseStatus({ ...status, cameras: [{ ...camera, age_s: Number.POSITIVE_INFINITY }] })).toBeNull()
  })

  it('knows a recording only while there is one', () => {
    const recorder = {
      folder: 'take1',
      frames_written: 40,
      frames_dropped: 1,
      megabytes_per_s: 12.5,
      minutes_left: null,
    }
    const parsed = parseStatus({ ...status, processes: { ...status.processes, recorder } })
    expect(parsed?.recording).toMatchObject({ folder: 'take1', written: 40, dropped: 1, minutesLeft: null })
    const gone = { ...recorder, status_age_s: 61 }
    expect(
      parseStatus({ ...status, processes: { ...status.processes, recorder: gone } })?.recording,
    ).toBeNull()
  })
})

describe('increments', () => {
  it('add up to the last count, whatever restarts and gaps lie between', () => {
    const steps = fc.array(fc.oneof(fc.nat(50), fc.constant('restart' as const)), { maxLength: 40 })
    fc.assert(
      fc.property(steps, (list) => {
        let count = 0
        let total = 0
        const counts = [0]
        for (const step of list) {
          count = step === 'restart' ? 0 : count + step
          total += step === 'restart' ? 0 : step
          counts.push(count)
        }
        const added = increments(counts)
        expect(added[0]).toBeNull()
        expect(added.slice(1).reduce<number>((sum, value) => sum + (value ?? Number.NaN), 0)).toBe(total)
      }),
    )
  })

  it('are unknown beside the unknown', () => {
    expect(increments([1, null, 4, 6])).toEqual([null, null, null, 2])
  })
})

describe('charts', () => {
  it('end at the first of 1, 2, 5 times a power of ten that holds every value', () => {
    fc.assert(
      fc.property(fc.array(fc.double({ min: 0, max: 1e9, noNaN: true }), { minLength: 1 }), (values) => {
        const top = scaleTop(values, 0.1)
        const largest = Math.max(0.1, ...values)
        expect(top).toBeGreaterThanOrEqual(largest * (1 - 1e-9))
        expect(top).toBeLessThan(largest * 2.5000001)
      }),
    )
  })

  it('draw the newest value at the right, the scale at the top, and nothing where nothing is known', () => {
    expect(linePath([SPAN_S, 0], [0, 5], 5)).toBe('M0.0 48.0L240.0 0.0')
    expect(linePath([3, 2, 1, 0], [1, null, 1, 1], 1).match(/M/g)).toHaveLength(2)
    expect(linePath([2 * SPAN_S], [1], 1)).toBe('')
  })
})

it('exposure times read as photographers write them', () => {
  expect([2, 0.5, 0.004, 1 / 8000, 40e-6].map(exposureTime)).toEqual([
    '2.0 s',
    '0.5 s',
    '1/250 s',
    '1/8000 s',
    '40 µs',
  ])
})

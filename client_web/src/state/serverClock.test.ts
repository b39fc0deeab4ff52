import * as fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import { ServerClock } from './serverClock'

describe('ServerClock', () => {
  it('knows nothing before the first heartbeat and after a reset', () => {
    const clock = new ServerClock()
    expect(clock.ageMs(1n, 0)).toBeNull()
    clock.observe(5_000_000n, 3)
    clock.reset()
    expect(clock.ageMs(1n, 0)).toBeNull()
  })

  it('errs by no more than the least delay of the network', () => {
    const delays = fc.array(fc.integer({ min: 1, max: 300 }), { minLength: 1, maxLength: 40 })
    fc.assert(
      fc.property(delays, fc.bigInt({ min: 0n, max: 1n << 60n }), (delay, bootNs) => {
        const clock = new ServerClock()
        delay.forEach((late, i) => {
          clock.observe(bootNs + BigInt(i * 500) * 1_000_000n, 7000 + i * 500 + late)
        })
        const now = delay.length * 500
        const captured = bootNs + BigInt(now - 50) * 1_000_000n
        const age = clock.ageMs(captured, 7000 + now) ?? Number.NaN
        expect(Math.abs(age - Math.max(0, 50 - Math.min(...delay)))).toBeLessThan(0.3)
      }),
    )
  })

  it('forgets old heartbeats, because clocks drift', () => {
    const clock = new ServerClock(2)
    clock.observe(100_000_000n, 0)
    clock.observe(10_000_000n, 0)
    clock.observe(10_000_000n, 0)
    expect(clock.ageMs(0n, 0)).toBeCloseTo(10, 6)
  })
})

import * as fc from 'fast-check'
import { describe, expect, it } from 'vitest'
import { LatestSender, type Timers } from './latestSender'

class FakeTimers implements Timers {
  time = 0
  #next = 1
  readonly #pending = new Map<number, { at: number; callback: () => void }>()

  now(): number {
    return this.time
  }

  setTimeout(callback: () => void, delayMs: number): number {
    this.#pending.set(this.#next, { at: this.time + delayMs, callback })
    return this.#next++
  }

  clearTimeout(handle: number): void {
    this.#pending.delete(handle)
  }

  advanceTo(time: number): void {
    for (;;) {
      const due = [...this.#pending]
        .filter(([, each]) => each.at <= time)
        .sort((a, b) => a[1].at - b[1].at)[0]
      if (!due) {
        break
      }
      this.#pending.delete(due[0])
      this.time = due[1].at
      due[1].callback()
    }
    this.time = time
  }
}

describe('LatestSender', () => {
  it('keeps the interval, sends the first at once and the last always', () => {
    const steps = fc.array(
      fc.record({ wait: fc.integer({ min: 0, max: 200 }), key: fc.constantFrom('a', 'b') }),
      {
        minLength: 1,
        maxLength: 60,
      },
    )
    fc.assert(
      fc.property(steps, (offers) => {
        const timers = new FakeTimers()
        const sent: { time: number; key: string; value: number }[] = []
        const sender = new LatestSender<string, number>(
          70,
          (key, value) => sent.push({ time: timers.time, key, value }),
          timers,
        )
        const last = new Map<string, number>()
        offers.forEach(({ wait, key }, value) => {
          timers.advanceTo(timers.time + wait)
          sender.offer(key, value)
          last.set(key, value)
        })
        timers.advanceTo(timers.time + 1000)
        expect(sent[0]).toEqual({ time: offers[0]?.wait, key: offers[0]?.key, value: 0 })
        for (let i = 1; i < sent.length; i++) {
          expect((sent[i]?.time ?? 0) - (sent[i - 1]?.time ?? 0)).toBeGreaterThanOrEqual(70)
        }
        for (const [key, value] of last) {
          const mine = sent.filter((each) => each.key === key)
          expect(mine.at(-1)?.value).toBe(value)
          for (let i = 1; i < mine.length; i++) {
            expect(mine[i]?.value).toBeGreaterThan(mine[i - 1]?.value ?? 0)
          }
        }
      }),
    )
  })

  it('is busy while a value waits or was just sent', () => {
    const timers = new FakeTimers()
    const sender = new LatestSender<number, number>(70, () => undefined, timers)
    expect(sender.isBusy(0, 500)).toBe(false)
    sender.offer(0, 1)
    expect(sender.isBusy(0, 500)).toBe(true)
    expect(sender.isBusy(1, 500)).toBe(false)
    timers.advanceTo(500)
    expect(sender.isBusy(0, 500)).toBe(false)
  })

  it('sends nothing after dispose', () => {
    const timers = new FakeTimers()
    const sent: number[] = []
    const sender = new LatestSender<number, number>(70, (_key, value) => sent.push(value), timers)
    sender.offer(0, 1)
    sender.offer(0, 2)
    sender.dispose()
    timers.advanceTo(1000)
    expect(sent).toEqual([1])
  })
})

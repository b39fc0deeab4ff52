import { describe, expect, it } from 'vitest'
import { PassRunner } from './passRunner'

type Key = 'camera' | 'light' | 'gbuffer'

function frame(runner: PassRunner<Key>): string[] {
  const ran: string[] = []
  runner.beginFrame()
  runner.run('gbuffer', ['camera'], ['gbuffer'], () => ran.push('gbuffer'))
  runner.run('shade', ['gbuffer', 'light'], [], () => ran.push('shade'))
  return ran
}

describe('PassRunner', () => {
  it('runs everything once, then nothing', () => {
    const runner = new PassRunner<Key>()
    expect(frame(runner)).toEqual(['gbuffer', 'shade'])
    expect(frame(runner)).toEqual([])
    expect(runner.reports.every((report) => !report.ran)).toBe(true)
  })

  it('runs what depends on a change, and what depends on that', () => {
    const runner = new PassRunner<Key>()
    frame(runner)
    runner.touch('light')
    expect(frame(runner)).toEqual(['shade'])
    expect(runner.reports[1]?.reason).toBe('changed: light')
    runner.touch('camera')
    expect(frame(runner)).toEqual(['gbuffer', 'shade'])
    expect(runner.reports[1]?.reason).toBe('changed: gbuffer')
  })

  it('runs a pass again after it was switched off, and all after a reset', () => {
    const runner = new PassRunner<Key>()
    frame(runner)
    runner.skip('shade', 'switched off')
    expect(frame(runner)).toEqual(['shade'])
    runner.reset()
    expect(frame(runner)).toEqual(['gbuffer', 'shade'])
  })
})

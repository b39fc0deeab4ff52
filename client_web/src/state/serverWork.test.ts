import { describe, expect, it } from 'vitest'
import { parseServerWork } from './serverWork'

function statusOf(illumination: unknown): unknown {
  return { protocol_version: 1, processes: { cam0: { frames: 3 }, illumination } }
}

const stage = {
  name: 'gather',
  ran: true,
  part: 0.25,
  reason: 'new pictures',
  wall_ms: 3,
  cpu_ms: 5,
  saved_ms: 15,
  error_bound: 0,
  updates_full: 1,
}
const skipping = { age_s: 2, saved_ms: 15, saved_total_ms: 400, spent_total_ms: 100, error_bound: 0.02 }

describe('parseServerWork', () => {
  it('reads what a technician is shown', () => {
    expect(parseServerWork(statusOf({ phase: 'running', stages: [stage], skipping }))).toEqual({
      stages: [{ name: 'gather', ran: true, part: 0.25, reason: 'new pictures', cpuMs: 5, savedMs: 15 }],
      ageMs: 2000,
      savedMs: 15,
      savedTotalMs: 400,
      spentTotalMs: 100,
      errorBound: 0.02,
    })
  })

  it.each([
    ['nothing', null],
    ['a server that prepares', statusOf({ phase: 'starting' })],
    ['a server without processes', { protocol_version: 1 }],
    ['a share above one', statusOf({ stages: [{ ...stage, part: 1.5 }], skipping })],
    ['numbers that are none', statusOf({ stages: [], skipping: { ...skipping, saved_ms: null } })],
  ])('has nothing to say about %s', (_, json) => {
    expect(parseServerWork(json)).toBeNull()
  })
})

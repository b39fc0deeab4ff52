import { describe, expect, it } from 'vitest'
import { ShadowSchedule } from './shadowSchedule'

describe('ShadowSchedule', () => {
  it('draws fresh lights first', () => {
    const schedule = new ShadowSchedule(8)
    for (let slot = 0; slot < 8; slot++) schedule.objectsChanged(slot)
    schedule.valChanged(6)
    expect(schedule.take(1)).toEqual([{ slot: 6, room: true, virtual: true }])
    expect(schedule.take(2).map((work) => work.slot)).toEqual([0, 1])
  })

  it('leaves the room layer alone when only objects move', () => {
    const schedule = new ShadowSchedule(4)
    schedule.objectsChanged(2)
    expect(schedule.take(4)).toEqual([{ slot: 2, room: false, virtual: true }])
  })

  it('starves no light: round robin goes on where it stopped', () => {
    const schedule = new ShadowSchedule(4)
    const drawn: number[] = []
    for (let frame = 0; frame < 4; frame++) {
      for (let slot = 0; slot < 4; slot++) schedule.fitChanged(slot)
      drawn.push(...schedule.take(2).map((work) => work.slot))
    }
    expect(drawn).toEqual([0, 1, 2, 3, 0, 1, 2, 3])
  })

  it('has nothing to do once all is drawn', () => {
    const schedule = new ShadowSchedule(4)
    schedule.valChanged(0)
    expect(schedule.pending).toBe(true)
    schedule.take(16)
    expect(schedule.pending).toBe(false)
    expect(schedule.take(16)).toEqual([])
  })
})

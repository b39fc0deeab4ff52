import { describe, expect, it } from 'vitest'
import { passName, passReason, stageName, stageReason } from './workWords'

describe('words for work', () => {
  it('names what is known and keeps the rest readable', () => {
    expect(stageName('gather')).toBe('Light from the cameras')
    expect(stageName('hidden_lamps')).toBe('Hidden lamps')
    expect(passName('gbuffer')).toBe('Visible surfaces')
    expect(passName('new_pass')).toBe('New pass')
  })

  it('says why in the same words', () => {
    expect(passReason('inputs unchanged')).toBe('unchanged')
    expect(passReason('changed: gbuffer, light data')).toBe('changed: visible surfaces, area lights')
    expect(passReason('first frame')).toBe('first frame')
  })

  it('calls objects by name', () => {
    expect(stageReason('objects [0] moved', ['Bunny', 'Dragon'])).toBe('Bunny moved')
    expect(stageReason('new light around objects [0, 1, 2]', ['Bunny', 'Dragon'])).toBe(
      'new light around Bunny, Dragon, object 3',
    )
    expect(stageReason('new pictures', ['Bunny'])).toBe('new pictures')
  })
})

import { describe, expect, it } from 'vitest'
import { passName, passReason, stageName } from './workWords'

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
})

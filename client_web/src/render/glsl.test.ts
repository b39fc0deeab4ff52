import { describe, expect, it } from 'vitest'
import { resolveIncludes, SHADERS } from './glsl'

const stages = Object.entries(SHADERS).flatMap(([name, { vertex, fragment }]) => [
  { name: `${name} vertex`, source: vertex, isFragment: false },
  { name: `${name} fragment`, source: fragment, isFragment: true },
])

describe.each(stages)('$name', ({ source, isFragment }) => {
  it('starts with its version and resolves every include', () => {
    expect(source.startsWith('#version 300 es\n')).toBe(true)
    expect(source).not.toMatch(/#include/)
  })

  it('computes in high precision throughout', () => {
    expect(source).not.toMatch(/\b(mediump|lowp)\b/)
    if (isFragment) expect(source).toMatch(/^precision highp float;$/m)
  })

  it('reads at most 16 textures', () => {
    expect((source.match(/^uniform .*\b[iu]?sampler\w+ /gm) ?? []).length).toBeLessThanOrEqual(16)
  })
})

describe('resolveIncludes', () => {
  it('names an unknown chunk', () => {
    expect(() => resolveIncludes('#include <nothing>')).toThrow(/nothing/)
  })
})

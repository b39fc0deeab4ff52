import { describe, expect, it } from 'vitest'
import { histogramPath } from './histogram'
import { canLook, freeNames, mayJoin, parseLook, parseState, parseWritten } from './model'

const camera = {
  index: 0,
  kind: 'gige',
  place: '192.168.10.21',
  name: 'Maker Eye',
  serial: '4711',
  state: 'free',
  advice: '',
  pixel_formats: ['Mono8'],
  pixel_format: 'Mono8',
  is_in_room: false,
}
const state = {
  room: { path: 'room.toml', exists: false, problem: '', camera_ids: [], default_name: 'lab' },
  models: ['room.glb'],
  notes: [],
  cameras: [camera],
}
const look = {
  picture: 'data:image/jpeg;base64,AAAA',
  width: 4,
  height: 3,
  pixel_format: 'Mono8',
  exposure_s: 0.01,
  exposure_range_s: [0.001, 1],
  histogram: [1, 0],
  saturated_share: 0,
  circle: null,
}

describe('answers of the server', () => {
  it('are taken as they are when they are whole', () => {
    expect(parseState(state)).toEqual({ value: state })
    expect(parseLook(look)).toEqual({ value: look })
  })

  it('are told in the words of the server when it refuses', () => {
    expect(parseWritten({ error: 'no model is chosen' })).toEqual({ error: 'no model is chosen' })
  })

  it('are refused when they are something else', () => {
    for (const picture of ['https://elsewhere.example/a.jpg', 'data:text/html,<b>', undefined]) {
      expect(parseLook({ ...look, picture })).toHaveProperty('error')
    }
    expect(parseState({ ...state, cameras: [{ ...camera, index: Number.NaN }] })).toHaveProperty('error')
    expect(parseState(null)).toHaveProperty('error')
  })
})

describe('names of new cameras', () => {
  it('fill the gaps and are never taken twice', () => {
    expect(freeNames(['cam0', 'door', 'cam2'], 3)).toEqual(['cam1', 'cam3', 'cam4'])
    expect(freeNames([], 0)).toEqual([])
  })
})

describe('cameras', () => {
  it('can be looked through when they are free and readable, and join once', () => {
    const cases = [
      camera,
      { ...camera, is_in_room: true },
      { ...camera, state: 'in use' },
      { ...camera, pixel_format: null },
    ]
    expect(cases.map(canLook)).toEqual([true, true, false, false])
    expect(cases.map(mayJoin)).toEqual([true, false, false, false])
  })
})

describe('the histogram', () => {
  it('is a closed area whose highest bin touches the top', () => {
    const path = histogramPath([0.25, 0, 1], 30, 10)
    expect(path.startsWith('M0 10')).toBe(true)
    expect(path.endsWith('L30 10Z')).toBe(true)
    const tops = [...path.matchAll(/V([\d.]+)H/g)].map((found) => Number(found[1]))
    // Heights are square roots of shares, so that small shares can be seen.
    expect(tops).toEqual([5, 10, 0])
  })

  it('is flat without pixels', () => {
    expect(histogramPath([0, 0], 20, 10)).toBe('M0 10V10H10V10H20L20 10Z')
  })
})

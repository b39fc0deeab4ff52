/** What passes depend on, and what options touch. */
import type { RendererOptions } from './types'

/** Everything that a pass can depend on. */
export type Key =
  | 'size'
  | 'camera'
  | 'poses'
  | 'light'
  | 'weights'
  | 'atlas'
  | 'shading options'
  | 'shadow option'
  | 'negligible light'
  | 'quality'
  | 'edges'
  | 'display options'
  | 'object light'
  | 'background'
  | 'shadow maps'
  | 'light data'
  | 'gbuffer'
  | 'tiles'
  | 'change'
  | 'coverage'
  | 'resolved'

export const OPTION_KEYS: Readonly<Record<keyof RendererOptions, Key>> = {
  exposure: 'display options',
  showVals: 'display options',
  selectedObject: 'display options',
  softClip: 'display options',
  shadows: 'shadow option',
  indirectOcclusion: 'shading options',
  tiled: 'shading options',
  fixtureRays: 'shading options',
  roomShadows: 'shading options',
  receiverRatio: 'shading options',
  fullQuality: 'quality',
  antiAliasing: 'edges',
}

/** Texts of the status page. */
import { duration, exposureTime, perSecond, share } from '../ui/format'
import type { Camera, CameraState } from './model'

export const words = {
  title: 'Cameras and light',
  back: 'Picture',
  metrics: 'For Prometheus',
  json: 'As JSON',
  cameras: 'Cameras',
  light: 'Light',
  processes: 'Processes',
  recording: 'Recording',
  noAnswer: 'The service does not answer. The numbers below are old.',
  waiting: 'Asking the service …',
  noCameras: 'No camera has spoken yet.',
  noPreview: 'No picture yet',
  previewOf: (id: string) => `What ${id} sees, tone-mapped; saturated pixels are marked`,
  state: {
    live: 'live',
    stale: 'old picture',
    lost: 'not connected',
    starting: 'starting',
  } satisfies Record<CameraState, string>,
  fields: {
    device: 'Device',
    exposure: 'Exposure',
    frames: 'Pictures',
    lost: 'Lost',
    broken: 'Broken',
    saturated: 'Saturated',
    age: 'Age in use',
    temperature: 'Temperature',
    reconnects: 'Opened again',
    restarts: 'Process restarted',
    clients: 'Tablets',
    packet: 'Light packet',
    backend: 'Computed by',
    uptime: 'Running for',
  },
  charts: {
    rate: 'Pictures',
    lost: 'Lost, broken',
    saturated: 'Saturated',
    age: 'Age in use',
    temperature: 'Temperature',
    lightAge: 'Age',
    updates: 'Updates',
    clients: 'Tablets',
  },
  restarted: (count: number) => (count === 0 ? '' : `started again ${count} ×`),
  recorded: (written: number, dropped: number) =>
    `${written} pictures written${dropped > 0 ? `, ${dropped} left out` : ''}`,
  room: (minutes: number) => `for ${duration(60_000 * minutes)}`,
}

export function exposures(camera: Camera): string | null {
  const gain = camera.gain !== null && Math.abs(camera.gain - 1) > 1e-3 ? ` × ${camera.gain.toFixed(2)}` : ''
  return camera.exposuresS.length === 0 ? null : `${camera.exposuresS.map(exposureTime).join(', ')}${gain}`
}

export function seconds(value: number): string {
  return duration(1000 * value)
}

export function celsius(value: number): string {
  return `${value.toFixed(0)} °C`
}

/** A number in words, if it is known. */
export function ifKnown(value: number | null, format: (value: number) => string): string | null {
  return value === null ? null : format(value)
}

export const formats = { seconds, celsius, share, perSecond, count: (value: number) => String(value) }

/**
 * What the status page knows: `GET /api/status` and `GET /api/history`, checked. The contracts are server/nearfield_server/gateway/camera_summary.py
 * and history.py. Numbers that a camera does not tell are null.
 */
import * as v from 'valibot'

const finite = v.pipe(v.number(), v.finite())
const known = v.nullish(finite, null)
const words = v.nullish(v.string(), null)

export type CameraState = 'live' | 'stale' | 'lost' | 'starting'

const camera = v.pipe(
  v.object({
    id: v.string(),
    process: v.string(),
    state: v.picklist(['live', 'stale', 'lost', 'starting']),
    fault: v.string(),
    warnings: v.array(v.string()),
    kind: words,
    model: words,
    frame_rate: known,
    frames: known,
    frames_lost: known,
    frames_broken: known,
    exposure_s: v.array(finite),
    gain: known,
    saturated_share: known,
    age_s: known,
    temperature_c: known,
    reconnects: known,
    restarts: known,
  }),
  v.transform((entry) => ({
    id: entry.id,
    process: entry.process,
    state: entry.state as CameraState,
    fault: entry.fault,
    warnings: entry.warnings,
    kind: entry.kind,
    model: entry.model,
    frameRate: entry.frame_rate,
    frames: entry.frames,
    framesLost: entry.frames_lost,
    framesBroken: entry.frames_broken,
    exposuresS: entry.exposure_s,
    gain: entry.gain,
    saturatedShare: entry.saturated_share,
    ageS: entry.age_s,
    temperatureC: entry.temperature_c,
    reconnects: entry.reconnects,
    restarts: entry.restarts,
  })),
)

const child = v.object({
  pid: v.nullable(finite),
  restarts: finite,
  last_fault: v.string(),
  fault: v.nullish(v.string(), null),
})

const status = v.object({
  clients: finite,
  max_clients: finite,
  light: v.object({ age_s: known, is_stale: v.boolean(), num_bytes: known }),
  cameras: v.array(camera),
  processes: v.record(v.string(), v.looseObject({ phase: v.nullish(v.string(), null), status_age_s: known })),
})

const supervisor = v.object({ uptime_s: finite, children: v.record(v.string(), child) })
const illumination = v.object({ backend: v.string(), light_age_s: known })
/** A recorder that is gone is remembered for a while, so that its last words can be read. */
const REMEMBERED_S = 60

const recorder = v.object({
  status_age_s: v.nullish(finite, 0),
  folder: v.string(),
  frames_written: finite,
  frames_dropped: finite,
  megabytes_per_s: known,
  minutes_left: known,
  warning: v.nullish(v.string(), ''),
})

const series = v.record(v.string(), v.array(v.nullable(finite)))
const history = v.object({
  ago_s: v.array(finite),
  light: series,
  cameras: v.record(v.string(), series),
})

export type Camera = v.InferOutput<typeof camera>

export interface Process {
  readonly name: string
  readonly phase: string
  readonly restarts: number
  /** What is wrong with it now, or why it was started again last; empty if nothing. */
  readonly words: string
  readonly isWell: boolean
}

export interface Recording {
  readonly folder: string
  readonly written: number
  readonly dropped: number
  readonly megabytesPerS: number | null
  readonly minutesLeft: number | null
  readonly warning: string
}

export interface Status {
  readonly cameras: readonly Camera[]
  readonly processes: readonly Process[]
  readonly recording: Recording | null
  readonly lightAgeS: number | null
  readonly isStale: boolean
  readonly packetBytes: number | null
  readonly backend: string | null
  readonly uptimeS: number | null
  readonly clients: number
  readonly maxClients: number
}

/** Samples, oldest first; `agoS` says how long ago each was. */
export interface History {
  readonly agoS: readonly number[]
  readonly light: Readonly<Record<string, readonly (number | null)[]>>
  readonly cameras: Readonly<Record<string, Readonly<Record<string, readonly (number | null)[]>>>>
}

/** The status, or null where the answer is none (of this release). */
export function parseStatus(json: unknown): Status | null {
  const parsed = v.safeParse(status, json)
  if (!parsed.success) {
    return null
  }
  const { cameras, processes, light, clients, max_clients } = parsed.output
  const supervision = v.safeParse(supervisor, processes.supervisor)
  const pipeline = v.safeParse(illumination, processes.illumination)
  return {
    cameras,
    processes: supervision.success ? processList(supervision.output.children, processes) : [],
    recording: parseRecording(processes.recorder),
    // As measured: the age in `light` grows with that of the report.
    lightAgeS: pipeline.success ? pipeline.output.light_age_s : light.age_s,
    isStale: light.is_stale,
    packetBytes: light.num_bytes,
    backend: pipeline.success ? pipeline.output.backend : null,
    uptimeS: supervision.success ? supervision.output.uptime_s : null,
    clients,
    maxClients: max_clients,
  }
}

function processList(
  children: Readonly<Record<string, v.InferOutput<typeof child>>>,
  statuses: Readonly<Record<string, { phase: string | null }>>,
): Process[] {
  return Object.entries(children).map(([name, entry]) => ({
    name,
    phase: entry.pid === null ? 'away' : (statuses[name]?.phase ?? 'starting'),
    restarts: entry.restarts,
    words: entry.fault ?? entry.last_fault,
    isWell: entry.pid !== null && entry.fault === null,
  }))
}

function parseRecording(json: unknown): Recording | null {
  const parsed = v.safeParse(recorder, json)
  if (!parsed.success || parsed.output.status_age_s > REMEMBERED_S) {
    return null
  }
  const entry = parsed.output
  return {
    folder: entry.folder,
    written: entry.frames_written,
    dropped: entry.frames_dropped,
    megabytesPerS: entry.megabytes_per_s,
    minutesLeft: entry.minutes_left,
    warning: entry.warning ?? '',
  }
}

export function parseHistory(json: unknown): History | null {
  const parsed = v.safeParse(history, json)
  return parsed.success
    ? { agoS: parsed.output.ago_s, light: parsed.output.light, cameras: parsed.output.cameras }
    : null
}

/** What was added between one sample and the next; a counter that went back has begun again at 0. */
export function increments(counts: readonly (number | null)[]): (number | null)[] {
  return counts.map((count, index) => {
    const before = index > 0 ? (counts[index - 1] ?? null) : null
    if (count === null || before === null) {
      return null
    }
    return count >= before ? count - before : count
  })
}

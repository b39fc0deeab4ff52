/**
 * What the light stages of the server did last and were spared since the start: part of `GET /api/status`, checked.
 * The contract is server/nearfield_server/illumination/work_ledger.py.
 */
import * as v from 'valibot'

const finite = v.pipe(v.number(), v.finite())
const nonNegative = v.pipe(finite, v.minValue(0))

const stage = v.object({
  name: v.string(),
  ran: v.boolean(),
  part: v.pipe(finite, v.minValue(0), v.maxValue(1)),
  reason: v.string(),
  cpu_ms: nonNegative,
  saved_ms: nonNegative,
})

const status = v.object({
  processes: v.object({
    illumination: v.object({
      stages: v.array(stage),
      skipping: v.object({
        age_s: v.nullable(finite),
        saved_ms: nonNegative,
        saved_total_ms: nonNegative,
        spent_total_ms: nonNegative,
        error_bound: nonNegative,
      }),
    }),
  }),
})

export interface StageWork {
  readonly name: string
  readonly ran: boolean
  /** Share of the stage's whole work that was done, 0 to 1. */
  readonly part: number
  readonly reason: string
  /** CPU time, ms. */
  readonly cpuMs: number
  readonly savedMs: number
}

export interface ServerWork {
  /** Of the last update in which anything had to be done. */
  readonly stages: readonly StageWork[]
  /** Time since that update, ms; null before the first. */
  readonly ageMs: number | null
  /** CPU time that skipping saved in that update, ms. */
  readonly savedMs: number
  readonly savedTotalMs: number
  readonly spentTotalMs: number
  /** Largest relative error of the light that skipping can have caused. */
  readonly errorBound: number
}

/** The account of the server's work, or null where a status holds none (yet), or of another release. */
export function parseServerWork(json: unknown): ServerWork | null {
  const parsed = v.safeParse(status, json)
  if (!parsed.success) {
    return null
  }
  const { stages, skipping } = parsed.output.processes.illumination
  return {
    stages: stages.map(({ name, ran, part, reason, cpu_ms, saved_ms }) => ({
      name,
      ran,
      part,
      reason,
      cpuMs: cpu_ms,
      savedMs: saved_ms,
    })),
    ageMs: skipping.age_s === null ? null : 1000 * skipping.age_s,
    savedMs: skipping.saved_ms,
    savedTotalMs: skipping.saved_total_ms,
    spentTotalMs: skipping.spent_total_ms,
    errorBound: skipping.error_bound,
  }
}

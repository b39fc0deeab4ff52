/** Property tests: always the same cases, so that a commit passes or fails once and for all; `PROPERTY_RUNS=5000` looks further. */
import fc from 'fast-check'

const runs = process.env.PROPERTY_RUNS
fc.configureGlobal(runs === undefined ? { seed: 1 } : { numRuns: Number(runs) })

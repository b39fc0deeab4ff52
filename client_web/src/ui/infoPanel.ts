import type { ServerWork, StageWork } from '../state/serverWork'
import { element, setText } from './dom'
import { bytes, duration, milliseconds, perSecond, share } from './format'
import { strings } from './strings'
import { type WorkItem, workSection } from './workSection'
import { passName, passReason, stageName, stageReason } from './workWords'

export interface PassReport {
  readonly name: string
  readonly ran: boolean
  readonly reason: string
}

/** Numbers about the light and the picture. */
export interface InfoNumbers {
  readonly connection: string
  readonly lightAgeMs: number | null
  readonly vals: number
  readonly packetBytes: number
  readonly updatesPerSecond: number
  readonly frameMs: number | null
  readonly width: number
  readonly height: number
  readonly passes: readonly PassReport[]
  /** What the server did and was spared; null if it does not say. */
  readonly work: ServerWork | null
}

export interface InfoPanel {
  readonly element: HTMLElement
  set(numbers: InfoNumbers): void
}

/** @param objectNames of the scene, as people read them. */
export function infoPanel(objectNames: readonly string[]): InfoPanel {
  const list = element('dl', { className: 'numbers' })
  const field = (label: string): HTMLElement => {
    const value = element('dd', {}, strings.info.unknown)
    list.append(element('dt', {}, label), value)
    return value
  }
  const connection = field(strings.info.connection)
  const age = field(strings.info.age)
  const vals = field(strings.info.vals)
  const size = field(strings.info.bytes)
  const rate = field(strings.info.rate)
  const frame = field(strings.info.frame)
  const scale = field(strings.info.scale)
  const saved = field(strings.info.saved)
  const savedTotal = field(strings.info.savedTotal)
  const error = field(strings.info.error)
  const server = workSection(strings.info.server)
  const device = workSection(strings.info.device)
  return {
    element: element(
      'div',
      { className: 'panel' },
      list,
      server.element,
      device.element,
      element('a', { className: 'more', href: './status' }, strings.info.more),
    ),
    set: (numbers) => {
      setText(connection, numbers.connection)
      setText(age, milliseconds(numbers.lightAgeMs))
      setText(vals, String(numbers.vals))
      setText(size, numbers.packetBytes > 0 ? bytes(numbers.packetBytes) : strings.info.unknown)
      setText(rate, numbers.updatesPerSecond > 0 ? perSecond(numbers.updatesPerSecond) : strings.info.unknown)
      setText(frame, milliseconds(numbers.frameMs))
      setText(scale, `${numbers.width} × ${numbers.height}`)
      const { work } = numbers
      setText(saved, work ? duration(work.savedMs) : strings.info.unknown)
      setText(savedTotal, work ? savedSinceStart(work) : strings.info.unknown)
      setText(error, work ? errorAdded(work.errorBound) : strings.info.unknown)
      server.set(
        (work?.stages ?? []).map((stage) => stageItem(stage, objectNames)),
        work?.ageMs ?? null,
      )
      device.set(numbers.passes.map(passItem), null)
    },
  }
}

function savedSinceStart(work: ServerWork): string {
  const all = work.savedTotalMs + work.spentTotalMs
  return strings.info.ofAll(duration(work.savedTotalMs), share(all > 0 ? work.savedTotalMs / all : 0))
}

function errorAdded(bound: number): string {
  return bound > 0 ? strings.info.atMost(share(bound)) : strings.info.noError
}

function stageItem(stage: StageWork, objectNames: readonly string[]): WorkItem {
  const { savedMs } = stage
  const reason = stageReason(stage.reason, objectNames)
  return {
    name: stageName(stage.name),
    ran: stage.ran,
    part: stage.part,
    reason: savedMs > 0 ? strings.work.saved(reason, duration(savedMs)) : reason,
  }
}

function passItem(pass: PassReport): WorkItem {
  return { name: passName(pass.name), ran: pass.ran, part: 1, reason: passReason(pass.reason) }
}

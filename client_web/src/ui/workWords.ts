/** Server stages and passes of this page in words for people. Unknown names stay readable: either side may be newer. */
import { readableName } from './format'
import { strings } from './strings'

const CHANGED = 'changed: '

export function stageName(name: string): string {
  return (strings.work.stages as Readonly<Record<string, string>>)[name] ?? readableName(name)
}

export function passName(name: string): string {
  return (strings.work.passes as Readonly<Record<string, string>>)[name] ?? readableName(name)
}

/** Why a pass ran or did not: "changed: gbuffer, tiles" names what it reads. */
export function passReason(reason: string): string {
  if (reason === 'inputs unchanged') {
    return strings.work.unchanged
  }
  if (!reason.startsWith(CHANGED)) {
    return reason
  }
  const inputs = reason.slice(CHANGED.length).split(', ')
  return strings.work.changed(inputs.map((input) => passName(input).toLowerCase()).join(', '))
}

/** Why a stage of the server ran: it counts objects from 0, people call them by name. */
export function stageReason(reason: string, objectNames: readonly string[]): string {
  return reason.replace(/objects \[([\d, ]*)\]/, (_, indices: string) =>
    indices
      .split(', ')
      .map((index) => objectNames[Number(index)] ?? strings.work.object(Number(index) + 1))
      .join(', '),
  )
}

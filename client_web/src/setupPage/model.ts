/** What the set-up page knows; the contract is server/nearfield_server/gateway/setup_app.py. */
import * as v from 'valibot'

const finite = v.pipe(v.number(), v.finite())
const text = v.string()

const camera = v.object({
  index: finite,
  kind: text,
  place: text,
  name: text,
  serial: text,
  state: text,
  advice: text,
  pixel_formats: v.array(text),
  pixel_format: v.nullable(text),
  is_in_room: v.boolean(),
})

const state = v.object({
  room: v.object({
    path: text,
    exists: v.boolean(),
    problem: text,
    camera_ids: v.array(text),
    default_name: text,
  }),
  models: v.array(text),
  notes: v.array(text),
  cameras: v.array(camera),
})

const look = v.object({
  picture: v.pipe(text, v.startsWith('data:image/jpeg;base64,')),
  width: finite,
  height: finite,
  pixel_format: text,
  exposure_s: finite,
  exposure_range_s: v.tuple([finite, finite]),
  histogram: v.array(finite),
  saturated_share: finite,
  circle: v.nullable(v.object({ x: finite, y: finite, radius: finite })),
})

const written = v.object({ path: text, cameras: v.array(text), next: text })
const failure = v.object({ error: text })

export type Camera = v.InferOutput<typeof camera>
export type SetupState = v.InferOutput<typeof state>
export type Look = v.InferOutput<typeof look>
export type Written = v.InferOutput<typeof written>

/** What the server answered, or why not in words. */
export type Answer<T> = { readonly value: T } | { readonly error: string }

export interface ChosenCamera {
  readonly index: number
  readonly id: string
  readonly pixel_format: string
  readonly exposure_s: number | null
  readonly field_degrees: number
}

export interface RoomRequest {
  readonly cameras: readonly ChosenCamera[]
  readonly name: string
  readonly model: string
}

const NO_ANSWER = 'No answer. Does `nearfield cameras --setup` still run?'
const NOT_UNDERSTOOD = 'The server answered something that this page does not understand. Reload it.'

function parse<Schema extends v.GenericSchema>(schema: Schema, json: unknown): Answer<v.InferOutput<Schema>> {
  const found = v.safeParse(schema, json)
  if (found.success) {
    return { value: found.output }
  }
  const failed = v.safeParse(failure, json)
  return { error: failed.success ? failed.output.error : NOT_UNDERSTOOD }
}

export const parseState = (json: unknown): Answer<SetupState> => parse(state, json)
export const parseLook = (json: unknown): Answer<Look> => parse(look, json)
export const parseWritten = (json: unknown): Answer<Written> => parse(written, json)

async function ask(url: string, options?: RequestInit): Promise<unknown> {
  try {
    const response = await fetch(url, options)
    return await response.json()
  } catch {
    return { error: NO_ANSWER }
  }
}

export async function readState(searchAgain: boolean): Promise<Answer<SetupState>> {
  return parseState(await (searchAgain ? ask('api/setup/search', { method: 'POST' }) : ask('api/setup')))
}

export async function readLook(
  index: number,
  pixelFormat: string,
  exposureS: number | null,
): Promise<Answer<Look>> {
  const query = new URLSearchParams({ pixel_format: pixelFormat })
  if (exposureS !== null) {
    query.set('exposure_s', String(exposureS))
  }
  return parseLook(await ask(`api/setup/cameras/${index}/look?${query}`))
}

/** Takes a picture with the exposure that suits what the camera sees. */
export async function findExposure(index: number, pixelFormat: string): Promise<Answer<Look>> {
  const query = new URLSearchParams({ pixel_format: pixelFormat })
  return parseLook(await ask(`api/setup/cameras/${index}/expose?${query}`, { method: 'POST' }))
}

export async function writeRoom(request: RoomRequest): Promise<Answer<Written>> {
  const headers = { 'Content-Type': 'application/json' }
  return parseWritten(await ask('api/setup/room', { method: 'POST', headers, body: JSON.stringify(request) }))
}

/** Whether there is anything to be seen through a camera from here. */
export function canLook(camera: Camera): boolean {
  return camera.state === 'free' && camera.pixel_format !== null
}

/** Whether a camera can be written into the room; twice makes no sense. */
export function mayJoin(camera: Camera): boolean {
  return canLook(camera) && !camera.is_in_room
}

/** The first names cam0, cam1, ... that are not taken. */
export function freeNames(taken: readonly string[], count: number): string[] {
  const names: string[] = []
  for (let number = 0; names.length < count; number += 1) {
    if (!taken.includes(`cam${number}`)) {
      names.push(`cam${number}`)
    }
  }
  return names
}

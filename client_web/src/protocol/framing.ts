// The message header and checked access to the bytes behind it. Nothing here trusts its input.

import { DecodeError, UnsupportedVersionError } from './errors'
import {
  MAGIC,
  MESSAGE_HEADER_BYTES,
  MessageType,
  readMessageHeader,
  VERSION,
  writeMessageHeader,
} from './layout.gen'

const MESSAGE_TYPES: readonly number[] = Object.values(MessageType)

export function require(
  holds: boolean,
  what: string,
  offset: number,
  expected: string | number,
  found: string | number,
): asserts holds {
  if (!holds) throw new DecodeError(what, offset, expected, found)
}

/** Checked, forward-only access to exactly one message. */
export class Reader {
  readonly view: DataView
  readonly messageType: MessageType
  readonly sequence: number
  offset = 0

  constructor(readonly buffer: ArrayBuffer) {
    this.view = new DataView(buffer)
    this.take(MESSAGE_HEADER_BYTES, 'message_header')
    const header = readMessageHeader(this.view, 0)
    const hex = (value: number) => `0x${value.toString(16).padStart(8, '0')}`
    require(header.magic === MAGIC, 'magic', 0, `${hex(MAGIC)} ('NFLD')`, hex(header.magic))
    if (header.version !== VERSION) throw new UnsupportedVersionError('version', 4, VERSION, header.version)
    const length = `${header.num_bytes} bytes`
    require(header.num_bytes === buffer.byteLength, 'message', header.num_bytes, length, buffer.byteLength)
    require(MESSAGE_TYPES.includes(
      header.message_type,
    ), 'message_type', 6, 'a known type', header.message_type)
    this.messageType = header.message_type as MessageType
    this.sequence = header.sequence
  }

  expect(messageType: MessageType): void {
    require(this.messageType === messageType, 'message_type', 6, messageType, this.messageType)
  }

  /** Claim the next bytes; returns where they begin. */
  take(numBytes: number, what: string): number {
    const start = this.offset
    const left = this.buffer.byteLength - start
    require(numBytes <= left, what, start, `${numBytes} bytes`, left)
    this.offset += numBytes
    return start
  }

  /** Claim a record whose `reserved` field must be 0. */
  record<T>(read: (view: DataView, offset: number) => T, numBytes: number, what: string): T {
    const start = this.take(numBytes, what)
    const record = read(this.view, start)
    const reserved = (record as { reserved?: number }).reserved ?? 0
    require(reserved === 0, `${what}.reserved`, start, 0, reserved)
    return record
  }

  /** Skip zeros up to the next multiple of 4 bytes. */
  padding(): void {
    const start = this.offset
    const count = -start & 3
    this.take(count, 'padding')
    for (let i = start; i < start + count; i++) {
      require(this.view.getUint8(i) === 0, 'padding', i, 0, this.view.getUint8(i))
    }
  }

  end(): void {
    require(this.offset === this.buffer.byteLength, 'message', this.offset, 'the end', this.buffer.byteLength)
  }
}

/** A new message of this size with its header written. */
export function startMessage(messageType: MessageType, sequence: number, bodyBytes: number): DataView {
  const view = new DataView(new ArrayBuffer(MESSAGE_HEADER_BYTES + bodyBytes))
  writeMessageHeader(view, 0, {
    magic: MAGIC,
    version: VERSION,
    message_type: messageType,
    sequence: sequence >>> 0,
    num_bytes: view.byteLength,
  })
  return view
}

/** Type and sequence of a message, after checking its header. */
export function peekHeader(buffer: ArrayBuffer): { messageType: MessageType; sequence: number } {
  const { messageType, sequence } = new Reader(buffer)
  return { messageType, sequence }
}

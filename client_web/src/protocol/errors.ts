/** Bytes that are not a valid message: what is wrong, at which byte, what was expected and found. */
export class DecodeError extends Error {
  override readonly name: string = 'DecodeError'
  constructor(
    readonly what: string,
    readonly offset: number,
    readonly expected: string | number,
    readonly found: string | number,
  ) {
    super(`${what} at byte ${offset}: expected ${expected}, found ${found}`)
  }
}

/** A message of another protocol version: the page is older or newer than the server. */
export class UnsupportedVersionError extends DecodeError {
  override readonly name = 'UnsupportedVersionError'
}

/** Values that cannot be written. */
export class EncodeError extends Error {
  override readonly name = 'EncodeError'
  constructor(
    readonly where: string,
    readonly expected: string,
    readonly found: string | number,
  ) {
    super(`${where}: expected ${expected}, found ${found}`)
  }
}

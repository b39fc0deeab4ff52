/** The renderer cannot start or go on; the message is for the person in front of the tablet. */
export class RendererError extends Error {
  override readonly name = 'RendererError'
}

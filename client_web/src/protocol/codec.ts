// Every message of the protocol, from and to bytes: the names that the rest of the client uses.

export { DecodeError, EncodeError, UnsupportedVersionError } from './errors'
export { peekHeader } from './framing'
export { CloseCode, Encoding, MessageType, SUBPROTOCOL, VERSION } from './layout.gen'
export * from './lightPacket'
export * from './messages'

"""All deliberate errors of the protocol.

    ProtocolError
    |- DecodeError                  bytes that are not a valid message
    |  |- TruncatedMessageError     fewer bytes than the message promises
    |  |- TrailingBytesError        more bytes than the message promises
    |  |- BadMagicError             not a message of this protocol at all
    |  |- UnsupportedVersionError   a message of another protocol version
    |  |- UnexpectedTypeError       a valid header of another message type than the reader wants
    |  |- LimitExceededError        a count above the limits of SPEC.md
    |  `- InvalidFieldError         a field holds a value that SPEC.md forbids
    |- EncodeError                  values that cannot be written
    `- SessionError                 the peer broke the rules of a session; says with which code to close

Messages are composed from the facts that each error stores.
"""

from __future__ import annotations

from nearfield_protocol.layout import CloseCode


class ProtocolError(Exception):
    """Base of all deliberate errors of the protocol."""


class DecodeError(ProtocolError):
    """Bytes that are not a valid message.

    Attributes:
        what: the field or part that is wrong.
        offset: bytes from the start of the message.
        expected: what SPEC.md asks for. found: what is there.
    """

    def __init__(self, what: str, *, offset: int, expected: object, found: object) -> None:
        self.what, self.offset, self.expected, self.found = what, offset, expected, found
        super().__init__(f"{what} at byte {offset}: expected {expected}, found {found}")


class TruncatedMessageError(DecodeError):
    """Fewer bytes than the message promises."""


class TrailingBytesError(DecodeError):
    """More bytes than the message promises."""


class BadMagicError(DecodeError):
    """Not a message of this protocol at all."""


class UnsupportedVersionError(DecodeError):
    """A message of another protocol version."""


class UnexpectedTypeError(DecodeError):
    """A valid header of another message type than the reader wants."""


class LimitExceededError(DecodeError):
    """A count above the limits of SPEC.md."""


class InvalidFieldError(DecodeError):
    """A field holds a value that SPEC.md forbids."""


class EncodeError(ProtocolError):
    """Values that cannot be written.

    Attributes:
        where: the record and field, such as `vals[3].position`.
        expected: what can be written. found: what was given.
    """

    def __init__(self, where: str, *, expected: object, found: object) -> None:
        self.where, self.expected, self.found = where, expected, found
        super().__init__(f"{where}: expected {expected}, found {found}")


class SessionError(ProtocolError):
    """The peer broke the rules of a session.

    Attributes:
        close_code: for the websocket's close frame. reason: in words, at most 123 bytes.
    """

    def __init__(self, close_code: CloseCode, reason: str) -> None:
        self.close_code, self.reason = close_code, reason
        super().__init__(f"{reason} (close code {int(close_code)})")

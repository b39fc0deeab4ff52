"""The message header and checked access to the bytes behind it. Nothing here trusts its input."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.errors import (
    BadMagicError,
    InvalidFieldError,
    LimitExceededError,
    TrailingBytesError,
    TruncatedMessageError,
    UnexpectedTypeError,
    UnsupportedVersionError,
)
from nearfield_protocol.layout import MAGIC, MESSAGE_HEADER, VERSION, MessageType

HEADER_BYTES = MESSAGE_HEADER.itemsize
TYPE_OFFSET = 6


class Header(NamedTuple):
    """A checked message header."""

    message_type: MessageType
    sequence: int


class Reader:
    """Checked, forward-only access to one message.

    Args:
        data: exactly one message.

    Raises:
        TruncatedMessageError, TrailingBytesError, BadMagicError, UnsupportedVersionError, UnexpectedTypeError: The header is wrong.
    """

    def __init__(self, data: bytes | bytearray | memoryview) -> None:
        self._data = bytes(data)
        self.offset = 0
        raw = self.record(MESSAGE_HEADER, "message_header")
        if raw["magic"] != MAGIC:
            raise BadMagicError(
                "magic", offset=0, expected=f"0x{MAGIC:08x} ('NFLD')", found=f"0x{int(raw['magic']):08x}"
            )
        if raw["version"] != VERSION:
            raise UnsupportedVersionError("version", offset=4, expected=VERSION, found=int(raw["version"]))
        if raw["num_bytes"] > len(self._data):
            raise TruncatedMessageError(
                "message", offset=len(self._data), expected=f"{raw['num_bytes']} bytes", found=len(self._data)
            )
        if raw["num_bytes"] < len(self._data):
            raise TrailingBytesError(
                "message",
                offset=int(raw["num_bytes"]),
                expected=f"{raw['num_bytes']} bytes",
                found=len(self._data),
            )
        try:
            message_type = MessageType(int(raw["message_type"]))
        except ValueError:
            known = ", ".join(str(int(value)) for value in MessageType)
            raise UnexpectedTypeError(
                "message_type", offset=TYPE_OFFSET, expected=f"one of {known}", found=int(raw["message_type"])
            ) from None
        self.header = Header(message_type, int(raw["sequence"]))

    def expect(self, message_type: MessageType) -> None:
        """Refuse any other message type."""
        if self.header.message_type is not message_type:
            raise UnexpectedTypeError(
                "message_type",
                offset=TYPE_OFFSET,
                expected=message_type.name,
                found=self.header.message_type.name,
            )

    def array(self, dtype: np.dtype[Any] | str, count: int, what: str) -> NDArray[Any]:
        """The next `count` elements as a read-only array on the message."""
        dtype = np.dtype(dtype)
        end = self.offset + dtype.itemsize * count
        if end > len(self._data):
            raise TruncatedMessageError(
                what,
                offset=self.offset,
                expected=f"{end - self.offset} bytes",
                found=len(self._data) - self.offset,
            )
        result: NDArray[Any] = np.frombuffer(self._data, dtype, count, self.offset)
        self.offset = end
        return result

    def record(self, dtype: np.dtype[Any], what: str) -> Any:
        """The next record; fields by name. A non-zero `reserved` field is refused."""
        start = self.offset
        record = self.array(dtype, 1, what)[0]
        fields = dtype.fields
        if fields is not None and "reserved" in fields and record["reserved"] != 0:
            at = start + fields["reserved"][1]
            raise InvalidFieldError(f"{what}.reserved", offset=at, expected=0, found=int(record["reserved"]))
        return record

    def padding(self) -> None:
        """Skip zeros up to the next multiple of 4 bytes."""
        count = -self.offset % 4
        start = self.offset
        if self.array("u1", count, "padding").any():
            raise InvalidFieldError(
                "padding", offset=start, expected="zeros", found=self._data[start : start + count].hex()
            )

    def end(self) -> None:
        """Refuse bytes that no field accounts for."""
        if self.offset != len(self._data):
            raise TrailingBytesError(
                "message",
                offset=self.offset,
                expected="the end",
                found=f"{len(self._data) - self.offset} bytes more",
            )


def check_limit(what: str, count: int, limit: int, offset: int) -> None:
    """Refuse a count above its limit.

    Raises:
        LimitExceededError: `count > limit`.
    """
    if count > limit:
        raise LimitExceededError(what, offset=offset, expected=f"at most {limit}", found=count)


def require(holds: bool, what: str, *, offset: int, expected: object, found: object) -> None:
    """Refuse a field value.

    Raises:
        InvalidFieldError: `holds` is false.
    """
    if not holds:
        raise InvalidFieldError(what, offset=offset, expected=expected, found=found)


def write_record(dtype: np.dtype[Any], **fields: Any) -> bytes:
    """One record as bytes; fields that are not given are 0."""
    record = np.zeros(1, dtype)
    for name, value in fields.items():
        record[name][0] = value
    return record.tobytes()


def frame(message_type: MessageType, sequence: int, *parts: bytes) -> bytes:
    """Put the message header before the parts. The sequence wraps at 2^32."""
    body = b"".join(parts)
    header = write_record(
        MESSAGE_HEADER,
        magic=MAGIC,
        version=VERSION,
        message_type=message_type,
        sequence=sequence & 0xFFFFFFFF,
        num_bytes=HEADER_BYTES + len(body),
    )
    return header + body


def peek_header(data: bytes) -> Header:
    """Check the header of a message without looking at the rest.

    Raises:
        DecodeError: The header is wrong or the length is not that of `data`.
    """
    return Reader(data).header

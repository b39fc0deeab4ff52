"""What a camera node and the service tell each other: frames in a binary form, questions and answers as JSON.

Everything here comes from another machine and is checked before it is used: sizes before memory is asked for, numbers before they are
believed. `decode_frame` never asks for more memory than the picture that it expects.

    frame    node -> service    header, mask of the tiles that follow, their byte planes (compressed)
    wish     service -> node    what has arrived (an acknowledgement), a question about the clock, the light weights
    answer   node -> service    the answer to that question, and how the camera is
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from nearfield_server.bus.messages import status_json
from nearfield_server.capture.remote.tile_planes import (
    WORD_BYTES,
    join_tiles,
    pixels_in_tiles,
    split_tiles,
    tile_grid,
)
from nearfield_server.capture.ring_memory import METADATA_BYTES
from nearfield_server.errors import CaptureError

MAGIC = b"NFR1"
MAX_SIDE = 16384
MAX_JSON_BYTES = 65536
_HEADER = struct.Struct("<4sBBHIIQQQqqIII")
_CODECS = ("none", "zstd")
_LEVEL = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameHeader:
    """What a frame says of itself.

    Attributes:
        width: pixels. height: pixels.
        session: random number of the sending process; revisions of different sessions have nothing to do with each other.
        revision: of the picture, from 1 upwards.
        base: the tiles in the frame are all that changed after this revision; 0 = every tile is in it.
        timestamp_ns: capture time, the node's CLOCK_MONOTONIC.
        confirmed_ns: when the camera last said that the picture still holds, likewise.
        period_us: time between frames that the node aims at.
        metadata: of the frame, for recordings; JSON of `frame_metadata`.
    """

    width: int
    height: int
    session: int
    revision: int
    base: int
    timestamp_ns: int
    confirmed_ns: int
    period_us: int
    metadata: bytes = b""


@dataclass(frozen=True, slots=True)
class FrameMessage:
    """A decoded frame: its header, (rows, columns) bool of the tiles in it, and their byte planes (8, pixels)."""

    header: FrameHeader
    tiles: NDArray[np.bool_]
    planes: NDArray[np.uint8]

    def paste(self, words: NDArray[np.uint64]) -> None:
        """Write the tiles into (height, width) words of four halves."""
        join_tiles(self.planes, self.tiles, words)


class FrameEncoder:
    """Makes frames; keep one per camera, it reuses the compressor.

    Args:
        compression: "zstd" or "none"; both are lossless.
    """

    def __init__(self, compression: str) -> None:
        self._codec = _CODECS.index(compression)
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL, write_content_size=True)

    def encode(self, header: FrameHeader, tiles: NDArray[np.bool_], words: NDArray[np.uint64]) -> bytes:
        """Return one frame.

        Args:
            header: see there.
            tiles: (rows, columns), which tiles to send; none = the picture is unchanged and only confirmed.
            words: (height, width), the whole picture.
        """
        planes = split_tiles(words, tiles)
        payload = b""
        if planes.size:
            payload = self._compressor.compress(planes.data) if self._codec else planes.tobytes()
        packed = _HEADER.pack(
            MAGIC,
            self._codec,
            0,
            0,
            header.width,
            header.height,
            header.session,
            header.revision,
            header.base,
            header.timestamp_ns,
            header.confirmed_ns,
            header.period_us,
            len(header.metadata),
            len(payload),
        )
        return b"".join((packed, header.metadata, np.packbits(tiles).tobytes(), payload))


def largest_frame_bytes(height: int, width: int) -> int:
    """Bytes that no honest frame of this size exceeds."""
    raw = height * width * WORD_BYTES
    return raw + raw // 128 + _HEADER.size + METADATA_BYTES + math.prod(tile_grid(height, width)) + 1024


def decode_frame(message: bytes, height: int, width: int) -> FrameMessage:
    """Parse and check a frame.

    Args:
        message: as it came from the network.
        height: rows that it must have, pixels.
        width: columns that it must have, pixels.

    Raises:
        CaptureError: it is none, or of another size; says what was found.
    """
    if len(message) < _HEADER.size or message[:4] != MAGIC:
        raise CaptureError(
            f"{len(message)} bytes that begin with {message[:4]!r}: expected a frame of this release, which begins with {MAGIC!r}"
        )
    (_, codec, flags, reserved, its_width, its_height, session, revision, base, *rest) = _HEADER.unpack_from(
        message
    )
    timestamp_ns, confirmed_ns, period_us, metadata_bytes, payload_bytes = rest
    if codec >= len(_CODECS) or flags or reserved:
        raise CaptureError(f"frame with compression {codec} and flags {flags}: this release knows neither")
    if (its_width, its_height) != (width, height):
        raise CaptureError(
            f"frames of {its_width}x{its_height} pixels, but the room file says {width}x{height}; "
            "the room file must have the size of what the node sends (after `reduce`)"
        )
    if session == 0 or revision == 0 or base > revision:
        raise CaptureError(f"frame with session {session}, revision {revision} after {base}: these cannot be")
    grid = tile_grid(height, width)
    mask_bytes = -(-math.prod(grid) // 8)
    if metadata_bytes > METADATA_BYTES or len(message) != (
        _HEADER.size + metadata_bytes + mask_bytes + payload_bytes
    ):
        raise CaptureError(
            f"frame of {len(message)} bytes, but its parts are {_HEADER.size}, {metadata_bytes}, {mask_bytes} and {payload_bytes}"
        )
    at = _HEADER.size + metadata_bytes
    bits = np.unpackbits(np.frombuffer(message, np.uint8, mask_bytes, at))
    if bits[math.prod(grid) :].any():
        raise CaptureError("frame with tiles beyond the picture")
    tiles = bits[: math.prod(grid)].astype(np.bool_).reshape(grid)
    if base == 0 and not tiles.all():
        raise CaptureError(
            f"frame that claims to be whole, but {int(np.count_nonzero(~tiles))} of its tiles are missing"
        )
    header = FrameHeader(
        width=width,
        height=height,
        session=session,
        revision=revision,
        base=base,
        timestamp_ns=timestamp_ns,
        confirmed_ns=confirmed_ns,
        period_us=period_us,
        metadata=message[_HEADER.size : at],
    )
    payload = message[at + mask_bytes :]
    return FrameMessage(header, tiles, _planes(payload, codec, pixels_in_tiles(tiles, height, width)))


def _planes(payload: bytes, codec: int, num_pixels: int) -> NDArray[np.uint8]:
    expected = num_pixels * WORD_BYTES
    if expected == 0:
        if payload:
            raise CaptureError(f"frame without tiles, but with {len(payload)} bytes of them")
        return np.zeros((WORD_BYTES, 0), np.uint8)
    if _CODECS[codec] == "zstd":
        try:
            # The size that a compressed block claims is checked before memory is asked for: a few bytes may claim gigabytes.
            claimed = zstandard.frame_content_size(payload)
            if claimed != expected:
                raise CaptureError(
                    f"compressed tiles that claim {claimed} bytes, expected {expected} for {num_pixels} pixels"
                )
            payload = zstandard.ZstdDecompressor(max_window_size=1 << 27).decompress(
                payload, max_output_size=expected
            )
        except (zstandard.ZstdError, MemoryError) as error:
            raise CaptureError(f"compressed tiles that are damaged ({error})") from error
    if len(payload) != expected:
        raise CaptureError(f"tiles of {len(payload)} bytes, expected {expected} for {num_pixels} pixels")
    return np.frombuffer(payload, np.uint8).reshape(WORD_BYTES, num_pixels)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What the service tells a node about one camera.

    Attributes:
        session: of the newest frame that arrived; 0 = none.
        revision: of that frame.
        asked_ns: the service's clock when it sent this; the node sends it back.
        light_weights: of the simulated lights; None = the room has none.
    """

    session: int
    revision: int
    asked_ns: int
    light_weights: tuple[float, ...] | None = None

    def to_json(self) -> bytes:
        """Serialise."""
        return json.dumps(
            {
                # Digits: JSON numbers beyond 2^53 are not safe everywhere.
                "session": str(self.session),
                "revision": str(self.revision),
                "asked_ns": str(self.asked_ns),
                "light_weights": None if self.light_weights is None else list(self.light_weights),
            },
            allow_nan=False,
        ).encode()

    @classmethod
    def from_json(cls, message: bytes) -> Wish:
        """Parse and check.

        Raises:
            CaptureError: malformed.
        """
        fields = parse_json(message, "wish")
        try:
            weights = fields["light_weights"]
            return cls(
                session=_digits(fields["session"]),
                revision=_digits(fields["revision"]),
                asked_ns=_digits(fields["asked_ns"]),
                light_weights=None if weights is None else tuple(_weight(weight) for weight in weights),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise CaptureError(f"wish: malformed ({type(error).__name__}: {error})") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a node answers.

    Attributes:
        asked_ns: from the wish.
        received_ns: the node's clock when the wish came.
        answered_ns: the node's clock when it sent this.
        fault: what is wrong with the camera, in words; empty = nothing.
        source: how the camera describes itself.
        node: numbers of the node, for the status page.
    """

    asked_ns: int
    received_ns: int
    answered_ns: int
    fault: str = ""
    source: dict[str, Any] = field(default_factory=dict)
    node: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> bytes:
        """Serialise."""
        return status_json(
            {
                "asked_ns": str(self.asked_ns),
                "received_ns": str(self.received_ns),
                "answered_ns": str(self.answered_ns),
                "fault": self.fault,
                "source": self.source,
                "node": self.node,
            }
        )

    @classmethod
    def from_json(cls, message: bytes) -> Answer:
        """Parse and check.

        Raises:
            CaptureError: malformed.
        """
        fields = parse_json(message, "answer")
        try:
            source, node = fields["source"], fields["node"]
            if not isinstance(source, dict) or not isinstance(node, dict):
                raise TypeError("source and node must be objects")
            return cls(
                asked_ns=_digits(fields["asked_ns"]),
                received_ns=_digits(fields["received_ns"]),
                answered_ns=_digits(fields["answered_ns"]),
                fault=str(fields["fault"])[:1000],
                source=source,
                node=node,
            )
        except (KeyError, TypeError, ValueError) as error:
            raise CaptureError(f"answer: malformed ({type(error).__name__}: {error})") from error


def parse_json(message: bytes, what: str) -> dict[str, Any]:
    """Parse a JSON object of at most 64 KiB.

    Raises:
        CaptureError: too long, or none.
    """
    if len(message) > MAX_JSON_BYTES:
        raise CaptureError(f"{what}: {len(message)} bytes, expected at most {MAX_JSON_BYTES}")
    try:
        fields = json.loads(message)
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{what}: not JSON ({error})") from error
    if not isinstance(fields, dict):
        raise CaptureError(f"{what}: {type(fields).__name__}, expected a JSON object")
    return fields


def _digits(value: Any) -> int:
    if not isinstance(value, str) or not value.isascii() or not value.isdigit() or len(value) > 20:
        raise ValueError(f"{str(value)[:40]!r}, expected a number as digits")
    number = int(value)
    if number >= 1 << 64:
        raise ValueError(f"{value}, expected less than 2^64")
    return number


def _weight(value: Any) -> float:
    weight = float(value)
    if not (math.isfinite(weight) and weight >= 0):
        raise ValueError(f"light weight {value}, expected a finite number >= 0")
    return weight

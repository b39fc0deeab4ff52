"""What is kept of a frame besides its pixels, and its form as JSON: the same in both formats."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any, Final

_MAX_INTEGER: Final = 1 << 63
MAX_INFO_BYTES: Final = 65536


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameInfo:
    """One recorded frame.

    Attributes:
        take: from 1; a recorder that was started again in the same folder begins the next take.
        sequence: from 1; number of the frame in its ring: together with camera and take it names the frame.
        content_revision: as in the ring; equal ones in a take mean equal pixels.
        timestamp_ns: capture time, CLOCK_MONOTONIC of the recording machine.
        counters: what ingest found ("nan", "saturated", ...).
        metadata: what the source said ("exposures_s", "gains", "device_ns", ...).
    """

    take: int
    sequence: int
    content_revision: int
    timestamp_ns: int
    counters: dict[str, int] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> tuple[int, int]:
        """Take and sequence: the order of recording."""
        return self.take, self.sequence

    def to_fields(self) -> dict[str, Any]:
        """As JSON has it; nanoseconds and revisions are strings, because other tools read JSON numbers as doubles."""
        return {
            "timestamp_ns": str(self.timestamp_ns),
            "take": self.take,
            "sequence": self.sequence,
            "content_revision": str(self.content_revision),
            "counters": self.counters,
            "metadata": self.metadata,
        }

    def to_json(self) -> str:
        """One line."""
        return json.dumps(self.to_fields(), separators=(",", ":"), allow_nan=False)


def info_from_fields(fields: Any) -> FrameInfo:
    """Read a frame's JSON object back.

    Raises:
        ValueError: a field is missing or impossible; says which.
    """
    if not isinstance(fields, dict):
        raise ValueError(f"expected an object, found {type(fields).__name__}")
    counters, metadata = fields.get("counters", {}), fields.get("metadata", {})
    if not isinstance(counters, dict) or not all(type(value) is int for value in counters.values()):
        raise ValueError(f"counters: expected an object of whole numbers, found {str(counters)[:60]!r}")
    if not isinstance(metadata, dict):
        raise ValueError(f"metadata: expected an object, found {str(metadata)[:60]!r}")
    return FrameInfo(
        take=_whole(fields, "take", 1),
        sequence=_whole(fields, "sequence", 1),
        content_revision=_whole(fields, "content_revision", 0),
        timestamp_ns=_whole(fields, "timestamp_ns", 0),
        counters=counters,
        metadata=metadata,
    )


def info_from_json(text: str | bytes) -> FrameInfo:
    """See `info_from_fields`.

    Raises:
        ValueError: not JSON, or wrong.
    """
    return info_from_fields(parse_json(text))


def parse_json(text: str | bytes) -> Any:
    """Parse JSON; whatever is wrong with it is a ValueError, nesting without end included."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _whole(fields: dict[str, Any], name: str, least: int) -> int:
    value = fields.get(name)
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= 20:
        value = int(value)
    if type(value) is not int or not least <= value < _MAX_INTEGER:
        raise ValueError(f"{name}: expected a whole number from {least} upwards, found {str(value)[:40]!r}")
    return value

"""What a camera looks like to the rest of the server."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class RawFrame:
    """One picture as the source delivers it, before the checks of `ingest`.

    Attributes:
        pixels: (H, W, 3 or 4) float32 or float16, linear radiance; a fourth channel <= 0.5 marks invalid pixels. Valid until the
            next call of `next_frame`: sources may reuse the memory.
        timestamp_ns: capture time, CLOCK_MONOTONIC.
        content_revision: from 1 upwards; must change whenever the pixels do, and should not otherwise.
        counters: numbers of the source itself for the status page ("saturated", "unreadable_files", ...).
    """

    pixels: NDArray[np.float32] | NDArray[np.float16]
    timestamp_ns: int
    content_revision: int
    counters: dict[str, int] = field(default_factory=dict)


class Source(Protocol):
    """A camera: opened once, asked for one frame per period, closed.

    All methods are called from one thread. Failures are `CaptureError` in words; after one the process reopens the source with back-off.
    """

    def open(self) -> None:
        """Acquire files or the device; raises CaptureError or AssetError."""

    def close(self) -> None:
        """Release everything; may be called twice."""

    def set_light_weights(self, weights: tuple[float, ...]) -> None:
        """Tell a simulated room how bright its switchable lights are; real cameras see the room and ignore this."""

    def next_frame(self, now_ns: int) -> RawFrame | None:
        """Return the picture at `now_ns` (CLOCK_MONOTONIC), or None if this period has none (it was dropped or unreadable)."""

    def describe(self) -> dict[str, str | int | float | bool]:
        """Describe the source for the status page."""

"""What a camera looks like to the rest of the server."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class RawFrame:
    """One picture as the source delivers it, before the checks of `ingest`.

    Attributes:
        pixels: (H, W, 3 or 4) float32 or float16, linear radiance; a fourth channel <= 0.5 marks invalid pixels, one between 0.5 and 1
            pixels of which the radiance is only a lower bound (saturated in every exposure). Valid until the next call of
            `next_frame`: sources may reuse the memory.
        timestamp_ns: capture time (middle of the exposure), CLOCK_MONOTONIC.
        content_revision: from 1 upwards; must change whenever the pixels do, and should not otherwise.
        counters: numbers of the source itself for the status page ("saturated", "unreadable_files", ...).
        metadata: what recordings keep of a frame, as JSON has it: "exposures_s", "gains", "device_ns" (digits), "frame_ids", ...
    """

    pixels: NDArray[np.float32] | NDArray[np.float16]
    timestamp_ns: int
    content_revision: int
    counters: dict[str, int] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict)


def wait_for_period(stop: threading.Event, period_s: float) -> None:
    """Wait for the next point of the grid that all simulated cameras of a machine keep to, as if triggered together.

    Light that changes is then seen by all of them in the same period. A late camera skips periods; it never hurries after them.
    """
    stop.wait(period_s - time.monotonic() % period_s)


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

    def wait_for_frame(self, stop: threading.Event, period_s: float) -> None:
        """Wait until it is worth calling `next_frame` again, `stop` is set, or about a tenth of a second has passed.

        Simulated cameras wait for the next period; devices wait for what the camera sends.
        """

    def next_frame(self, now_ns: int) -> RawFrame | None:
        """Return the picture at `now_ns` (CLOCK_MONOTONIC), or None if there is none now (dropped, unreadable, not there yet)."""

    def describe(self) -> dict[str, Any]:
        """Describe the source for the status page, as JSON has it; called after every frame, also while the source is closed."""

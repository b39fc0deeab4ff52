"""Tells a picture that does not change any more from a room in which nothing happens, and other things that a user should know."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Final

import numpy as np
from numpy.typing import NDArray

FROZEN_AFTER_S: Final = 2.0
_FROZEN_PICTURES: Final = 8
_SAMPLES: Final = 16381
_NOISY_SHARE: Final = 0.2
_NOISY_PICTURES: Final = 30
_LEAST_RANGE: Final = 8


class FrozenWatch:
    """Notices that a camera sends the same picture again and again.

    A sensor has noise: two exposures of one scene differ in a good part of their pixels. But not every device shows it (simulated ones,
    sensors of few bits, denoised video), and a black or saturated picture has none. So equal pictures count as frozen only after this
    device has shown noise all over the picture in thirty pictures running, and only if they are neither black nor white.
    """

    def __init__(self) -> None:
        self._samples: dict[Hashable, NDArray[np.uint8]] = {}
        self._noisy = 0
        self._is_noisy = False
        self._equal_since_ns: int | None = None
        self._equal = 0

    def is_frozen(self, now_ns: int) -> bool:
        """Whether pictures have been the same, bit for bit, for two seconds although the sensor is known to have noise."""
        return (
            self._is_noisy
            and self._equal >= _FROZEN_PICTURES
            and self._equal_since_ns is not None
            and now_ns - self._equal_since_ns >= FROZEN_AFTER_S * 1e9
        )

    def restart(self) -> None:
        """The device was opened again; what is known of its noise stays."""
        self._samples.clear()
        self._equal, self._equal_since_ns = 0, None

    def observe(self, kind: Hashable, data: NDArray[np.uint8], now_ns: int) -> None:
        """Take a picture.

        Args:
            kind: pictures are compared with the one before of the same kind (exposure).
            data: (bytes,) uint8, as it came; a sample is copied.
            now_ns: CLOCK_MONOTONIC.
        """
        # An odd step meets all columns and both bytes of a code.
        step = max(1, data.size // _SAMPLES) | 1
        sample = data[::step].copy()
        before = self._samples.get(kind)
        self._samples[kind] = sample
        if before is None or before.size != sample.size:
            return
        different = int(np.count_nonzero(sample != before))
        if different:
            self._equal, self._equal_since_ns = 0, None
            self._noisy = self._noisy + 1 if different > _NOISY_SHARE * sample.size else 0
            self._is_noisy |= self._noisy >= _NOISY_PICTURES
            return
        if sample.size and int(sample.max()) - int(sample.min()) >= _LEAST_RANGE:
            self._equal += 1
            self._equal_since_ns = self._equal_since_ns or now_ns


def exposure_differs(commanded: float, found: float, tolerance: float = 0.02) -> bool:
    """Whether an exposure amount (seconds times gain) is not the one that was set; devices round."""
    return abs(found - commanded) > tolerance * commanded

"""Labels that a camera adds to each picture (chunk data): how it was exposed."""

from __future__ import annotations

import math

from nearfield_server.capture.aravis.exposure_control import checked_exposure
from nearfield_server.capture.aravis.features import Features
from nearfield_server.capture.aravis.library import Aravis, AravisError
from nearfield_server.capture.device import Exposure

_EXPOSURE_NAMES = (b"ChunkExposureTime", b"ChunkExposureTimeAbs")


def switch_labels_on(features: Features) -> bool:
    """Let the camera label exposures, and gains if it can; false if it cannot, and nothing is then added to pictures.

    Raises:
        AravisError: the camera does not answer.
    """
    if not features.set_if_possible("ChunkModeActive", True):
        return False
    labelled = any(_enable(features, name) for name in ("ExposureTime", "ExposureTimeAbs"))
    if not labelled:
        features.set_if_possible("ChunkModeActive", False)
        return False
    _enable(features, "Gain")
    return True


class LabelReader:
    """Reads the exposure of pictures from their chunks.

    Args:
        aravis: the library.
        device: the ArvDevice.

    Attributes:
        parser: the ArvChunkParser, or None; its reference is given back by whoever owns the reader.
    """

    def __init__(self, aravis: Aravis, device: int) -> None:
        self._c = aravis.c
        self.parser = aravis.c.arv_device_create_chunk_parser(device)
        self._has_gain = True

    def exposure(self, buffer: int, gain: float) -> Exposure | None:
        """Exposure of a picture; `gain` is taken where the picture does not tell. None if it tells nothing, or what cannot be."""
        if self.parser is None or not self._c.arv_buffer_has_chunks(buffer):
            return None
        time_us = next(
            (us for name in _EXPOSURE_NAMES if (us := self._number(buffer, name)) is not None), None
        )
        if time_us is None:
            return None
        gain_db = self._number(buffer, b"ChunkGain") if self._has_gain else None
        self._has_gain = gain_db is not None
        return checked_exposure(time_us * 1e-6, 20.0 * math.log10(gain) if gain_db is None else gain_db)

    def _number(self, buffer: int, name: bytes) -> float | None:
        if self.parser is None:
            return None
        for function in (
            self._c.arv_chunk_parser_get_float_value,
            self._c.arv_chunk_parser_get_integer_value,
        ):
            try:
                return float(function(self.parser, buffer, name))
            except AravisError:
                continue
        return None


def _enable(features: Features, name: str) -> bool:
    return features.set_if_possible("ChunkSelector", name) and features.set_if_possible("ChunkEnable", True)

"""The sequencer of a camera: a list of exposures that it cycles through by itself. Source: GenICam SFNC 2.7, chapter 16."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from nearfield_server.capture.aravis.exposure_control import ExposureControl
from nearfield_server.capture.aravis.features import Features
from nearfield_server.capture.device import Exposure
from nearfield_server.errors import CaptureError

_NEEDED: Final = (
    "SequencerMode",
    "SequencerConfigurationMode",
    "SequencerSetSelector",
    "SequencerSetSave",
    "SequencerSetNext",
)
_ADVANCE: Final = ("FrameStart", "ExposureStart", "FrameEnd", "ExposureEnd", "ExposureActive")


class Sequencer:
    """Programs and runs the sequencer; the stream must be stopped meanwhile.

    Args:
        features: of the device.
        exposure: sets what a step of the sequence has.
        where: names the camera in messages.
    """

    def __init__(self, features: Features, exposure: ExposureControl, where: str) -> None:
        self._features, self._exposure, self._where = features, exposure, where
        self.is_offered = all(features.kind(name) is not None for name in _NEEDED)
        self.is_running = False

    def program(self, exposures: Sequence[Exposure]) -> tuple[Exposure, ...]:
        """Let every picture advance to the next exposure, and after the last to the first; returns them as the device rounded them.

        Raises:
            CaptureError: more exposures than the sequencer has sets, or it refuses one.
        """
        features = self._features
        self.stop()
        features.set("SequencerConfigurationMode", "On")
        least, greatest = features.range("SequencerSetSelector")
        if len(exposures) > greatest - least + 1:
            raise CaptureError(
                f"{self._where}: its sequencer has {greatest - least + 1:.0f} sets; expected at most so many exposures, "
                f"found {len(exposures)}"
            )
        first = int(least)
        features.set_if_possible("SequencerFeatureSelector", "ExposureTime")
        features.set_if_possible("SequencerFeatureEnable", True)
        rounded = []
        for index, exposure in enumerate(exposures):
            features.set("SequencerSetSelector", first + index)
            rounded.append(self._exposure.set(exposure))
            features.set_if_possible("SequencerPathSelector", 0)
            features.set("SequencerSetNext", first + (index + 1) % len(exposures))
            self._advance_with_every_frame()
            features.execute("SequencerSetSave")
        features.set_if_possible("SequencerSetStart", first)
        features.set("SequencerConfigurationMode", "Off")
        features.set("SequencerMode", "On")
        self.is_running = True
        return tuple(rounded)

    def stop(self) -> None:
        """Back to one exposure for every picture."""
        self._features.set_if_possible("SequencerMode", "Off")
        self._features.set_if_possible("SequencerConfigurationMode", "Off")
        self.is_running = False

    def _advance_with_every_frame(self) -> None:
        if self._features.has("SequencerTriggerSource") and not any(
            self._features.set_if_possible("SequencerTriggerSource", source) for source in _ADVANCE
        ):
            raise CaptureError(
                f"{self._where}: its sequencer cannot advance with every picture; expected SequencerTriggerSource to offer one of "
                f"{', '.join(_ADVANCE)}, found {', '.join(self._features.entries('SequencerTriggerSource'))}"
            )

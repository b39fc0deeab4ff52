"""Opens connected cameras for a look: the devices and the development that the service uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.aravis.device import AravisDevice
from nearfield_server.capture.device import Device, SensorFrame
from nearfield_server.capture.v4l2.device import V4l2Device
from nearfield_server.errors import ConfigError
from nearfield_server.imaging.development import Developer
from nearfield_server.onboarding.connected import Connected
from nearfield_server.onboarding.viewer import Decode
from nearfield_server.scene.device_schema import DeviceSourceTable, V4l2SourceTable

LOOK_RATE: Final = 5.0
"""Frames per second asked of a camera that somebody looks through: little, so that all cameras fit on one link."""


def open_camera(camera: Connected, table: DeviceSourceTable) -> tuple[Callable[[], Device], Decode]:
    """What makes the device of a camera, and what turns its frames into signal; see `session.OpenCamera`.

    Raises:
        ConfigError: the camera does not tell the size of its pictures.
    """
    width, height = camera.size_of(table.pixel_format)
    if width <= 0 or height <= 0:
        raise ConfigError(
            f"{camera.name}: it does not tell the size of its pictures; write its table by hand, with width and height"
        )

    def make_device() -> Device:
        if isinstance(table, V4l2SourceTable):
            return V4l2Device(camera.name, table, width, height, LOOK_RATE)
        return AravisDevice(camera.name, table, width, height, LOOK_RATE)

    return make_device, SignalDecoder(table)


class SignalDecoder:
    """Codes to the share of the signal range of their exposure, by the development that the service uses.

    Args:
        table: response and saturation of the camera.
    """

    def __init__(self, table: DeviceSourceTable) -> None:
        self._table = table
        self._developer: Developer | None = None

    def __call__(self, frame: SensorFrame) -> NDArray[np.float32]:
        """(H, W, 4) float32 signal, alpha below 1 where it is saturated; raises CaptureError or ConfigError."""
        developer = self._developer
        kind = (frame.pixel_format, frame.width, frame.height)
        if developer is None or kind != (developer.format.name, developer.width, developer.height):
            developer = self._developer = Developer(self._table, *kind)
        picture = np.empty((frame.height, frame.width, 4), np.float16)
        # With an exposure of one second at gain 1, radiance is signal.
        return developer.develop(frame.data, frame.row_bytes, 1.0, picture).astype(np.float32)

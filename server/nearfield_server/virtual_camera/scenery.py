"""What a simulated camera looks at: a camera of a room of the virtual lab, lamps and all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.cameras import make_source
from nearfield_server.capture.lab_source import LabSource
from nearfield_server.errors import ConfigError
from nearfield_server.scene.room_config import RoomConfig


class Scenery:
    """The noise-free radiance that a camera of a room receives."""

    def __init__(self, room: RoomConfig, camera_id: str) -> None:
        """Read the basis pictures of a camera.

        Raises:
            ConfigError: there is no such camera, or it is none of the virtual lab.
            AssetError, CaptureError: its pictures are missing, broken, or of another size.
        """
        names = [camera.camera_id for camera in room.cameras]
        if camera_id not in names:
            raise ConfigError(f"room {room.name}: no camera {camera_id!r}; there are {', '.join(names)}")
        index = names.index(camera_id)
        source = make_source(room, index, {})
        if not isinstance(source, LabSource):
            raise ConfigError(
                f"room {room.name}: camera {camera_id} is of kind {room.sources[index].kind}; a test camera shows a camera of kind lab"
            )
        self._source = source
        self._source.open()
        self.nominal_weights = tuple(light.weight for light in room.lights)

    def radiance(self, weights: tuple[float, ...]) -> NDArray[np.float32]:
        """(H, W, 3) float32, W/(sr m^2), under these weights of the lamps; valid until the next call."""
        self._source.set_light_weights(weights)
        frame = self._source.next_frame(0)
        assert frame is not None
        return np.asarray(frame.pixels, np.float32)

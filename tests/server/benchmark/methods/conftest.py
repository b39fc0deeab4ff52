"""A box room in closed form as the surroundings of the baselines."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.benchmark.methods.light import PROBE_RESOLUTION, AtlasSample, Surroundings
from nearfield_server.reference.box_room import BoxRoom, lamp_field, make_box_room


@pytest.fixture(scope="session")
def room() -> BoxRoom:
    return make_box_room(atlas_size=64, camera_size=48)


@pytest.fixture(scope="session")
def around(room: BoxRoom) -> Surroundings:
    centres = room.size * np.array([[0.3, 0.3, 0.4], [0.6, 0.4, 0.6]])
    middle = 0.5 * room.size
    return Surroundings(
        texels=room.texels,
        object_centres=centres,
        object_probes=tuple(room.trace(centre, PROBE_RESOLUTION) for centre in centres),
        room_centre=middle,
        room_probe=room.trace(middle, PROBE_RESOLUTION),
        room_diagonal=float(np.linalg.norm(room.size)),
    )


@pytest.fixture(scope="session")
def lamp_sample(room: BoxRoom) -> AtlasSample:
    """A lamp in the ceiling, a window, and dim walls."""
    field = lamp_field(
        room,
        ((3, (0.5, 0.5), (0.1, 0.1), (40.0, 38.0, 30.0)), (0, (0.5, 0.6), (0.1, 0.2), (10.0, 12.0, 15.0))),
    )
    return AtlasSample(frames=(), radiance=room.texel_field(field).astype(np.float32))

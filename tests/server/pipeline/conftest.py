"""One small box room for all tests of the light stages."""

import numpy as np
import pytest

from nearfield_server.pipeline.blocks import BlockPool
from nearfield_server.records import ObjectPose
from nearfield_server.reference.box_room import BoxRoom, RadianceField, lamp_field, make_box_room


@pytest.fixture(scope="session")
def room() -> BoxRoom:
    return make_box_room(atlas_size=96, camera_size=96)


@pytest.fixture(scope="session")
def two_lamps(room: BoxRoom) -> RadianceField:
    ceiling = (3, (0.3, 0.4), (0.08, 0.12), (40.0, 38.0, 30.0))
    wall = (0, (0.5, 0.6), (0.1, 0.2), (10.0, 12.0, 15.0))
    return lamp_field(room, (ceiling, wall))


@pytest.fixture(scope="session")
def pool() -> BlockPool:
    return BlockPool(2)


@pytest.fixture
def poses() -> list[ObjectPose]:
    result = []
    for index, position in enumerate([(2.0, 1.0, 2.0), (4.0, 0.5, 1.0)]):
        world_from_object = np.eye(4)
        world_from_object[:3, 3] = position
        result.append(
            ObjectPose(
                object_index=index,
                revision=1,
                world_from_object=world_from_object,
                centre_object=np.array([0.0, 0.1, 0.0]),
                radius=0.2,
            )
        )
    return result

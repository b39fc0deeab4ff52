"""Virtual objects as the pipeline takes them: where they stand, and the spheres around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.records import ObjectPlacement, ObjectPose
from nearfield_server.scene.model_source import load_source_model
from nearfield_server.scene.room_config import RoomConfig


@dataclass(frozen=True, slots=True)
class ObjectBounds:
    """Bounding sphere of an object in its own axes: centre (3,) float64, radius in metres."""

    centre: NDArray[np.float64]
    radius: float


def object_bounds(positions: NDArray[np.floating[Any]]) -> ObjectBounds:
    """Return the sphere around the centre of the bounding box of (V, 3) positions, as prepared models have it."""
    points = np.asarray(positions, np.float64)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return ObjectBounds(centre, float(np.linalg.norm(points - centre, axis=1).max()))


def load_bounds(room: RoomConfig) -> list[ObjectBounds]:
    """Bounds of every object of a room."""
    return [object_bounds(load_source_model(item.model_path).positions) for item in room.objects]


def object_poses(placements: Sequence[ObjectPlacement], bounds: Sequence[ObjectBounds]) -> list[ObjectPose]:
    """Return placements as the pipeline takes them.

    Raises:
        ValueError: there are not as many as bounds.
    """
    return [
        ObjectPose(
            object_index=index,
            revision=placement.revision,
            world_from_object=placement.world_from_object,
            centre_object=sphere.centre,
            radius=sphere.radius,
        )
        for index, (placement, sphere) in enumerate(zip(placements, bounds, strict=True))
    ]

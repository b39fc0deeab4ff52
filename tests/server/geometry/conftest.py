"""A small furnished room with fish-eyes, in closed form enough for exact checks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from nearfield_calibration.models import FisheyeIntrinsics
from nearfield_server.records import CameraModel, RoomMesh

ATLAS_SIZE = 240


@dataclass(frozen=True)
class Quad:
    corner: tuple[float, float, float]
    first: tuple[float, float, float]
    second: tuple[float, float, float]
    material: int


def room_from_quads(quads: list[Quad], atlas_size: int, density: float) -> RoomMesh:
    """One chart per quad, packed on shelves with a gap of four texels; front normal first x second."""
    positions, normals, uv, faces, materials = [], [], [], [], []
    x = y = shelf = 4.0
    shelf = 0.0
    for number, quad in enumerate(quads):
        corner, first, second = (
            np.array(v, dtype=np.float64) for v in (quad.corner, quad.first, quad.second)
        )
        width, height = density * np.linalg.norm(first), density * np.linalg.norm(second)
        if x + width + 4 > atlas_size:
            x, y, shelf = 4.0, y + shelf + 4, 0.0
        assert y + height + 4 <= atlas_size, "atlas too small for the test room"
        positions += [corner, corner + first, corner + first + second, corner + second]
        normals += [np.cross(first, second) / np.linalg.norm(np.cross(first, second))] * 4
        uv += [[x, y], [x + width, y], [x + width, y + height], [x, y + height]]
        faces += [[4 * number, 4 * number + 1, 4 * number + 2], [4 * number, 4 * number + 2, 4 * number + 3]]
        materials += [quad.material] * 2
        x, shelf = x + width + 4, max(shelf, height)
    count = max(materials) + 1
    return RoomMesh(
        positions=np.array(positions),
        normals=np.array(normals),
        uv=np.array(uv) / atlas_size,
        faces=np.array(faces, dtype=np.int32),
        face_material=np.array(materials, dtype=np.int32),
        materials=tuple(f"material{index}" for index in range(count)),
        material_albedo=np.full((count, 3), 0.5),
        uv_source="file",
        content_hash="test room",
    )


def furnished_quads() -> list[Quad]:
    """3 x 2 x 3 m: floor, ceiling, walls (material 0), a table (1), a lamp under the ceiling (2) and one flush in it (3)."""
    return [
        Quad((0, 0, 0), (0, 0, 3), (3, 0, 0), 0),
        # Ceiling in two pieces around the flush lamp (a T-junction), the lamp, and the rest of its strip.
        Quad((0, 2, 0), (3, 0, 0), (0, 0, 1), 0),
        Quad((0, 2, 1), (1, 0, 0), (0, 0, 2), 0),
        Quad((1, 2, 1), (0.5, 0, 0), (0, 0, 0.5), 3),
        Quad((1.5, 2, 1), (1.5, 0, 0), (0, 0, 0.5), 0),
        Quad((1, 2, 1.5), (2, 0, 0), (0, 0, 1.5), 0),
        Quad((0, 0, 0), (0, 2, 0), (0, 0, 3), 0),
        Quad((3, 0, 0), (0, 0, 3), (0, 2, 0), 0),
        Quad((0, 0, 0), (3, 0, 0), (0, 2, 0), 0),
        Quad((0, 0, 3), (0, 2, 0), (3, 0, 0), 0),
        # Table top, seen from above and below.
        Quad((1, 0.7, 1), (0, 0, 1), (1, 0, 0), 1),
        Quad((1, 0.66, 1), (1, 0, 0), (0, 0, 1), 1),
        # Hanging lamp.
        Quad((2.2, 1.6, 1.9), (0.3, 0, 0), (0, 0, 0.3), 2),
        Quad((2.2, 1.61, 1.9), (0, 0, 0.3), (0.3, 0, 0), 0),
    ]


def fisheye_camera(
    name: str, eye: tuple[float, float, float], target: tuple[float, float, float], size: int
) -> CameraModel:
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    world_from_camera[:3, 3] = eye
    return CameraModel(
        camera_id=name,
        intrinsics=FisheyeIntrinsics(
            width=size,
            height=size,
            fx=size / math.pi,
            fy=size / math.pi,
            cx=(size - 1) / 2,
            cy=(size - 1) / 2,
            k=(0.0, 0.0, 0.0, 0.0),
            theta_max=math.pi / 2,
        ),
        world_from_camera=world_from_camera,
    )


@pytest.fixture(scope="session")
def furnished_room() -> RoomMesh:
    return room_from_quads(furnished_quads(), ATLAS_SIZE, density=24.3)


@pytest.fixture(scope="session")
def cameras() -> tuple[CameraModel, ...]:
    return (
        fisheye_camera("cam0", (0.15, 1.8, 0.2), (1.5, 0.7, 1.5), 192),
        fisheye_camera("cam1", (2.8, 1.2, 2.75), (1.4, 0.8, 1.4), 160),
    )

from __future__ import annotations

import numpy as np

from nearfield_calibration.fisheye import unproject
from nearfield_server.geometry.camera_view import RoomRays
from nearfield_server.geometry.face_groups import face_groups
from nearfield_server.geometry.silhouettes import boundary_edges, find_borders
from nearfield_server.geometry.texels import face_normals
from nearfield_server.records import CameraModel, RoomMesh
from nearfield_server.reference.visibility import first_face


def test_edges_inside_a_surface_are_no_boundary(furnished_room: RoomMesh) -> None:
    edges = boundary_edges(furnished_room, face_groups(furnished_room))
    length = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    # The diagonal of the 3 x 3 m floor joins its two triangles.
    assert not np.isclose(length, np.sqrt(18)).any()
    # The four sides of the flush lamp bound it.
    at_lamp = (np.abs(edges[..., 1] - 2.0) < 1e-9).all(axis=1)
    at_lamp &= (edges[..., [0, 2]] >= 1 - 1e-9).all(axis=(1, 2)) & (edges[..., [0, 2]] <= 1.5 + 1e-9).all(
        axis=(1, 2)
    )
    assert at_lamp.sum() >= 4


def test_unmarked_pixels_show_one_surface_everywhere(
    furnished_room: RoomMesh, cameras: tuple[CameraModel, ...]
) -> None:
    groups, normals = face_groups(furnished_room), face_normals(furnished_room)
    edges = boundary_edges(furnished_room, groups)
    rng = np.random.default_rng(7)
    for camera in cameras:
        borders = find_borders(RoomRays(furnished_room), edges, groups, normals, camera)
        assert not (borders.touched & ~borders.near).any()
        lens = camera.intrinsics
        row, column = (rng.integers(0, size, 1500) for size in (lens.height, lens.width))
        shifts = rng.uniform(-0.5, 0.5, (12, 2))
        points = np.stack([column, row], axis=-1)[:, None] + shifts
        directions, valid = unproject(points, lens)
        inside = valid.all(axis=1)
        world = directions[inside].reshape(-1, 3) @ camera.world_from_camera[:3, :3].T
        face, _ = first_face(
            furnished_room, np.broadcast_to(camera.world_from_camera[:3, 3], world.shape), world
        )
        front = (normals[face] * world).sum(axis=1) < 0
        surface = np.where((face >= 0) & front, groups[face], -1).reshape(-1, len(shifts))
        mixed = (surface != surface[:, :1]).any(axis=1)
        touched = borders.touched[row, column][inside]
        assert mixed.any()
        assert touched[mixed].all()
        # And the marks are no broader than needed: most pixels stay free.
        assert borders.near.mean() < 0.2

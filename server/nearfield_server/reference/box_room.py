"""An empty box room in closed form: texels, gather table, probes and pictures without any file or ray tracer.

Its inner walls see each other completely, so visibility is exact by construction. Tests and benchmarks use it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from nearfield_calibration import fisheye
from nearfield_calibration.models import FisheyeIntrinsics
from nearfield_server.geometry.morton import morton_code
from nearfield_server.radiometry.cube import cube_directions
from nearfield_server.records import CameraModel, GatherTable, RoomMesh, TexelGeometry

# Charts in a 3 x 2 grid; faces -x +x -y +y -z +z of the room, (axis, side, column axis, row axis).
_FACES: Final = ((0, 0, 2, 1), (0, 1, 2, 1), (1, 0, 0, 2), (1, 1, 0, 2), (2, 0, 0, 1), (2, 1, 0, 1))
_GUTTER: Final = 2
RadianceField = Callable[[NDArray[np.float64], NDArray[np.int64]], NDArray[np.float64]]
"""(P, 3) positions on the walls and (P,) face numbers to (P, 3) radiance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoxRoom:
    """A box `[0, size]` seen from inside.

    Attributes:
        size: (3,) metres.
        atlas_size: rows and columns of the atlas.
        resolution: (columns, rows) of each face's chart.
        texels: in Morton order, as those of every room.
        cameras: fish-eyes in the upper corners.
        table: gather table.
    """

    size: NDArray[np.float64]
    atlas_size: int
    resolution: tuple[int, int]
    texels: TexelGeometry
    cameras: tuple[CameraModel, ...]
    table: GatherTable

    def mesh(self, albedo: float = 0.5) -> RoomMesh:
        """The room as twelve triangles of one material."""
        return _box_mesh(self, albedo)

    def hit(self, origin: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """(D, 3) points where rays from inside leave the box."""
        with np.errstate(divide="ignore"):
            limit = np.where(directions > 0.0, self.size - origin, -origin) / directions
        limit = np.where(directions == 0.0, np.inf, limit)
        return np.asarray(origin + directions * limit.min(axis=-1, keepdims=True))

    def face_of(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """(P,) number of the wall nearest to each point."""
        return np.asarray(
            np.stack([points, self.size - points], axis=-1).reshape(*points.shape[:-1], 6).argmin(axis=-1)
        )

    def texel_at(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """(P,) texel that covers each wall point."""
        columns, rows = self.resolution
        face = self.face_of(points)
        table = np.array(_FACES)
        relative = points / self.size
        pick = np.arange(points.shape[0])
        column = np.clip((relative[pick, table[face, 2]] * columns).astype(np.int64), 0, columns - 1)
        row = np.clip((relative[pick, table[face, 3]] * rows).astype(np.int64), 0, rows - 1)
        left, top = _chart_corner(face, self.atlas_size)
        return np.asarray(self.texels.lookup[top + row, left + column], dtype=np.int32)

    def trace(self, centre_world: NDArray[np.float64], resolution: int = 32) -> NDArray[np.int32]:
        """Texel behind each pixel of a cube, as `geometry.probes.ProbeRays.trace`."""
        return self.texel_at(
            self.hit(np.asarray(centre_world, dtype=np.float64), cube_directions(resolution))
        )

    def sees(
        self, origin_world: NDArray[np.float64], targets_world: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """All of them: the box is empty."""
        return np.ones(len(targets_world), dtype=np.bool_)

    def texel_field(self, field: RadianceField) -> NDArray[np.float64]:
        """(N, 3) radiance of a field at the texel centres."""
        position = self.texels.position.astype(np.float64)
        return field(position, self.face_of(position))

    def picture(self, camera_index: int, field: RadianceField) -> NDArray[np.float16]:
        """(H, W, 4) float16: what a camera sees of a radiance field; alpha 0 outside the image circle."""
        camera = self.cameras[camera_index]
        height, width = self.table.camera_shapes[camera_index]
        x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        directions, valid = fisheye.unproject(np.stack([x, y], axis=-1).reshape(-1, 2), camera.intrinsics)
        pixels = np.zeros((height * width, 4), dtype=np.float16)
        world = directions[valid] @ camera.world_from_camera[:3, :3].T
        points = self.hit(camera.world_from_camera[:3, 3], world)
        pixels[valid, :3] = field(points, self.face_of(points))
        pixels[valid, 3] = 1.0
        return pixels.reshape(height, width, 4)


def make_box_room(
    *,
    size: tuple[float, float, float] = (6.0, 3.0, 4.0),
    atlas_size: int = 128,
    num_cameras: int = 4,
    camera_size: int = 128,
) -> BoxRoom:
    """Build a box room with fish-eye cameras (180 degrees, equidistant) that look at its middle.

    Raises:
        ValueError: the atlas is too small for its six charts.
    """
    columns, rows = atlas_size // 3 - 2 * _GUTTER, atlas_size // 2 - 2 * _GUTTER
    if columns < 1 or rows < 1:
        raise ValueError(f"atlas of {atlas_size} texels cannot hold six charts")
    extent = np.array(size, dtype=np.float64)
    texels = _texels(extent, atlas_size, columns, rows)
    cameras = tuple(_camera(extent, index, camera_size) for index in range(num_cameras))
    table = _gather_table(texels, cameras)
    return BoxRoom(
        size=extent,
        atlas_size=atlas_size,
        resolution=(columns, rows),
        texels=texels,
        cameras=cameras,
        table=table,
    )


def hide_texels(table: GatherTable, hidden: NDArray[np.bool_]) -> GatherTable:
    """The gather table without the pairs of some (N,) texels, as if no camera saw them."""
    count = np.diff(table.pair_start)
    keep = ~np.repeat(hidden, count)
    return GatherTable(
        pair_start=np.concatenate([[0], np.cumsum(np.where(hidden, 0, count))]).astype(np.int64),
        camera=table.camera[keep],
        pixel=table.pixel[keep],
        fraction_x=table.fraction_x[keep],
        fraction_y=table.fraction_y[keep],
        weight=table.weight[keep],
        camera_shapes=table.camera_shapes,
    )


def lamp_field(
    room: BoxRoom,
    lamps: tuple[tuple[int, tuple[float, float], tuple[float, float], tuple[float, float, float]], ...],
    ambient: float = 1.0,
) -> RadianceField:
    """A field of rectangular lamps on smoothly shaded walls.

    Args:
        room: the room.
        lamps: (face, relative centre, relative half size, radiance) of each lamp.
        ambient: radiance of the walls, which varies by a third around it.
    """

    def field(points: NDArray[np.float64], face: NDArray[np.int64]) -> NDArray[np.float64]:
        relative = points / room.size
        shade = ambient * (1.0 + np.sin(relative @ np.array([5.0, 3.0, 4.0])) / 3.0)
        radiance = shade[:, None] * np.array([1.0, 0.8, 0.6])
        table = np.array(_FACES)[face]
        pick = np.arange(points.shape[0])
        u, v = relative[pick, table[:, 2]], relative[pick, table[:, 3]]
        for lamp_face, centre, half, lamp_radiance in lamps:
            inside = (
                (face == lamp_face) & (np.abs(u - centre[0]) <= half[0]) & (np.abs(v - centre[1]) <= half[1])
            )
            radiance[inside] = lamp_radiance
        return np.asarray(radiance)

    return field


def _texels(size: NDArray[np.float64], atlas_size: int, columns: int, rows: int) -> TexelGeometry:
    position, normal, area, index = [], [], [], []
    u = (np.arange(columns) + 0.5) / columns
    v = (np.arange(rows) + 0.5) / rows
    for face, (axis, side, column_axis, row_axis) in enumerate(_FACES):
        left, top = _chart_corner(face, atlas_size)
        points = np.empty((rows, columns, 3))
        points[..., axis] = side * size[axis]
        points[..., column_axis] = u[None, :] * size[column_axis]
        points[..., row_axis] = v[:, None] * size[row_axis]
        inward = np.zeros(3)
        inward[axis] = 1.0 - 2.0 * side
        chart = (np.arange(top, top + rows)[:, None] * atlas_size + np.arange(left, left + columns)).reshape(
            -1
        )
        position.append(points.reshape(-1, 3))
        normal.append(np.broadcast_to(inward, (rows * columns, 3)))
        area.append(np.full(rows * columns, size[column_axis] * size[row_axis] / (rows * columns)))
        index.append(chart)
    texel_index = np.concatenate(index)
    order = np.argsort(morton_code(*np.divmod(texel_index, atlas_size)), kind="stable")
    texel_index = texel_index[order].astype(np.int32)
    lookup = np.full(atlas_size * atlas_size, -1, dtype=np.int32)
    lookup[texel_index] = np.arange(texel_index.size, dtype=np.int32)
    none = np.zeros(0, dtype=np.int32)
    return TexelGeometry(
        height=atlas_size,
        width=atlas_size,
        texel_index=texel_index,
        position=np.concatenate(position)[order].astype(np.float32),
        normal=np.concatenate(normal)[order].astype(np.float32),
        area=np.concatenate(area)[order].astype(np.float32),
        face=(np.repeat(np.arange(6), rows * columns) * 2)[order].astype(np.int32),
        lookup=lookup.reshape(atlas_size, atlas_size),
        gutter_texel=none,
        gutter_source=none,
    )


def _chart_corner(face: Any, atlas_size: int) -> tuple[Any, Any]:
    """Column and row of the first texel of a face's chart; an array of faces gives arrays."""
    return face % 3 * (atlas_size // 3) + _GUTTER, face // 3 * (atlas_size // 2) + _GUTTER


def _camera(size: NDArray[np.float64], index: int, resolution: int) -> CameraModel:
    corner = np.array([index & 1, 1, (index >> 1) & 1], dtype=np.float64)
    position = size * (0.5 + 0.8 * (corner - 0.5))
    forward = 0.5 * size - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    world_from_camera[:3, 3] = position
    centre = 0.5 * (resolution - 1)
    intrinsics = FisheyeIntrinsics(
        width=resolution,
        height=resolution,
        fx=resolution / np.pi,
        fy=resolution / np.pi,
        cx=centre,
        cy=centre,
        k=(0.0, 0.0, 0.0, 0.0),
        theta_max=0.5 * np.pi,
    )
    return CameraModel(camera_id=f"cam{index}", intrinsics=intrinsics, world_from_camera=world_from_camera)


def _gather_table(texels: TexelGeometry, cameras: tuple[CameraModel, ...]) -> GatherTable:
    """Bilinear taps of every camera that sees a texel, weighted by the angle to the camera's axis (ATL2)."""
    position = texels.position.astype(np.float64)
    seen, pixel, fraction, weight = [], [], [], []
    for camera in cameras:
        camera_from_world = np.linalg.inv(camera.world_from_camera)
        points = position @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
        pixels, valid = fisheye.project(points, camera.intrinsics)
        width, height = camera.intrinsics.width, camera.intrinsics.height
        valid &= (pixels >= 0.0).all(axis=1) & (pixels[:, 0] < width - 1) & (pixels[:, 1] < height - 1)
        base = np.floor(np.where(valid[:, None], pixels, 0.0))
        seen.append(valid)
        pixel.append(base[:, 1].astype(np.int64) * width + base[:, 0].astype(np.int64))
        fraction.append(np.where(valid[:, None], pixels - base, 0.0))
        weight.append(np.where(valid, np.maximum(points[:, 2] / np.linalg.norm(points, axis=1), 1e-3), 0.0))
    mask = np.stack(seen, axis=1)
    weights = np.stack(weight, axis=1)
    weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-30)
    fractions = np.stack(fraction, axis=1)[mask]
    return GatherTable(
        pair_start=np.concatenate([[0], np.cumsum(mask.sum(axis=1))]).astype(np.int64),
        camera=np.broadcast_to(np.arange(len(cameras), dtype=np.uint8), mask.shape)[mask],
        pixel=np.stack(pixel, axis=1)[mask].astype(np.uint32),
        fraction_x=fractions[:, 0].astype(np.float32),
        fraction_y=fractions[:, 1].astype(np.float32),
        weight=weights[mask].astype(np.float32),
        camera_shapes=tuple((camera.intrinsics.height, camera.intrinsics.width) for camera in cameras),
    )


def _box_mesh(room: BoxRoom, albedo: float) -> RoomMesh:
    positions, normals, uv, faces = [], [], [], []
    columns, rows = room.resolution
    for face, (axis, side, column_axis, row_axis) in enumerate(_FACES):
        left, top = _chart_corner(face, room.atlas_size)
        inward = np.zeros(3)
        inward[axis] = 1.0 - 2.0 * side
        corners = np.zeros((4, 3))
        corners[:, axis] = side * room.size[axis]
        corners[:, column_axis] = np.array([0.0, 1.0, 1.0, 0.0]) * room.size[column_axis]
        corners[:, row_axis] = np.array([0.0, 0.0, 1.0, 1.0]) * room.size[row_axis]
        chart = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], dtype=np.float64)
        chart += np.array([left, top])
        order = np.array([[0, 1, 2], [0, 2, 3]])
        if np.cross(corners[1] - corners[0], corners[2] - corners[0]) @ inward < 0.0:
            order = order[:, ::-1]
        positions.append(corners)
        normals.append(np.broadcast_to(inward, (4, 3)))
        uv.append(chart / room.atlas_size)
        faces.append(order + 4 * face)
    return RoomMesh(
        positions=np.concatenate(positions),
        normals=np.concatenate(normals),
        uv=np.concatenate(uv),
        faces=np.concatenate(faces).astype(np.int32),
        face_material=np.zeros(12, dtype=np.int32),
        materials=("wall",),
        material_albedo=np.full((1, 3), albedo),
        uv_source="file",
        content_hash=f"box-{room.size.tolist()}-{room.atlas_size}",
    )

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nearfield_calibration.fisheye import project, unproject
from nearfield_server.errors import ConfigError
from nearfield_server.geometry.camera_view import RoomRays, visible_texels
from nearfield_server.geometry.face_groups import face_groups
from nearfield_server.geometry.gather_table import MIN_RELATIVE_WEIGHT, build_gather_table, find_unseen_fill
from nearfield_server.geometry.texels import face_normals, rasterise_texels
from nearfield_server.records import CameraModel, GatherTable, RoomMesh, TexelGeometry
from nearfield_server.reference.visibility import first_face

LAMPS = (2, 3)  # materials
LAMP_RADIANCE = 1000.0


@pytest.fixture(scope="module")
def texels(furnished_room: RoomMesh) -> TexelGeometry:
    return rasterise_texels(furnished_room, 240, rasteriser="cpu")


@pytest.fixture(scope="module")
def table(furnished_room: RoomMesh, texels: TexelGeometry, cameras: tuple[CameraModel, ...]) -> GatherTable:
    return build_gather_table(furnished_room, texels, cameras)


def antialiased_picture(
    mesh: RoomMesh, camera: CameraModel, supersampling: int = 4, around: tuple[int, int] | None = None
) -> np.ndarray:
    """(H, W) float64: every pixel is the mean over its own area; lamps shine, all else is 1, back faces are black.

    With `around` (row, column), only the pixels near it are drawn and the rest is 1.
    """
    lens = camera.intrinsics
    shifts = (np.arange(supersampling) + 0.5) / supersampling - 0.5
    total = np.zeros((lens.height, lens.width))
    columns, rows = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
    if around is not None:
        window = (slice(around[0] - 6, around[0] + 7), slice(around[1] - 6, around[1] + 7))
        columns, rows, total = columns[window], rows[window], np.zeros((13, 13))
    radiance = np.where(np.isin(mesh.face_material, LAMPS), LAMP_RADIANCE, 1.0)
    normals = face_normals(mesh)
    for shift_y in shifts:
        for shift_x in shifts:
            directions, valid = unproject(np.stack([columns + shift_x, rows + shift_y], axis=-1), lens)
            world = directions[valid] @ camera.world_from_camera[:3, :3].T
            face, _ = first_face(mesh, np.broadcast_to(camera.world_from_camera[:3, 3], world.shape), world)
            front = (face >= 0) & ((normals[face] * world).sum(axis=1) < 0)
            total[valid] += np.where(front, radiance[face], 0.0)
    if around is None:
        return total / supersampling**2
    picture = np.ones((lens.height, lens.width))
    picture[window] = total / supersampling**2
    return picture


def gather(table: GatherTable, pictures: list[np.ndarray]) -> np.ndarray:
    """(N,) float64: the blend that the table describes, written out plainly."""
    count = len(table.pair_start) - 1
    texel = np.repeat(np.arange(count), np.diff(table.pair_start))
    values = np.zeros(len(texel))
    for index, picture in enumerate(pictures):
        chosen = table.camera == index
        row, column = np.divmod(table.pixel[chosen].astype(np.int64), picture.shape[1])
        x, y = table.fraction_x[chosen].astype(float), table.fraction_y[chosen].astype(float)
        top = picture[row, column] * (1 - x) + picture[row, column + 1] * x
        bottom = picture[row + 1, column] * (1 - x) + picture[row + 1, column + 1] * x
        values[chosen] = top * (1 - y) + bottom * y
    return np.bincount(texel, weights=values * table.weight, minlength=count)


def test_lamps_do_not_bleed(
    furnished_room: RoomMesh, texels: TexelGeometry, table: GatherTable, cameras: tuple[CameraModel, ...]
) -> None:
    pictures = [antialiased_picture(furnished_room, camera) for camera in cameras]
    gathered = gather(table, pictures)
    is_lamp = np.isin(furnished_room.face_material[texels.face], LAMPS)
    seen = np.diff(table.pair_start) > 0
    truth = np.where(is_lamp, LAMP_RADIANCE, 1.0)
    area = texels.area.astype(np.float64)
    total = (truth * area)[seen].sum()
    spurious = np.maximum(((gathered - truth) * area)[seen & ~is_lamp], 0.0).sum()
    assert spurious <= 1e-3 * total
    assert abs((gathered * area)[seen].sum() - total) <= 1e-3 * total
    np.testing.assert_allclose(gathered[seen & is_lamp], LAMP_RADIANCE, rtol=1e-5)


def with_tiny_lamp(mesh: RoomMesh, albedo: float) -> RoomMesh:
    """The room plus a lamp of 12 x 12 mm on the wall: less than a pixel in both cameras (16 and 20 milliradians)."""
    corners = np.array([[0.02, 1.2, 1.5], [0.02, 1.212, 1.5], [0.02, 1.212, 1.512], [0.02, 1.2, 1.512]])
    start = len(mesh.positions)
    material = len(mesh.materials)
    return replace(
        mesh,
        positions=np.concatenate([mesh.positions, corners]),
        normals=np.concatenate([mesh.normals, np.tile([[1.0, 0.0, 0.0]], (4, 1))]),
        uv=np.concatenate(
            [mesh.uv, (np.array([[0, 0], [2, 0], [2, 2], [0, 2]]) + np.array([230, 225])) / 240]
        ),
        faces=np.concatenate(
            [mesh.faces, [[start, start + 1, start + 2], [start, start + 2, start + 3]]]
        ).astype(np.int32),
        face_material=np.append(mesh.face_material, [material, material]).astype(np.int32),
        materials=(*mesh.materials, "tiny"),
        material_albedo=np.concatenate([mesh.material_albedo, [[albedo] * 3]]),
    )


def test_lamp_smaller_than_a_pixel_is_not_lost_if_it_is_black(
    furnished_room: RoomMesh, cameras: tuple[CameraModel, ...]
) -> None:
    mesh = with_tiny_lamp(furnished_room, 0.0)
    texels = rasterise_texels(mesh, 240, rasteriser="cpu")
    table = build_gather_table(mesh, texels, cameras)
    lit = replace(mesh, face_material=np.where(mesh.face_material == 4, LAMPS[0], 0).astype(np.int32))
    pictures = []
    for camera in cameras:
        offset = mesh.positions[-4] - camera.world_from_camera[:3, 3]
        column, row = np.rint(
            project(offset @ camera.world_from_camera[:3, :3], camera.intrinsics)[0]
        ).astype(int)
        pictures.append(antialiased_picture(lit, camera, 16, around=(row, column)))
    gathered = gather(table, pictures)
    is_lamp = texels.face >= len(furnished_room.faces)
    # The best of the pixels around holds at least a ninth of it, and never more than all of it.
    picture_share = max(((picture - 1) / LAMP_RADIANCE).max() for picture in pictures)
    assert gathered[is_lamp].max() <= LAMP_RADIANCE
    assert gathered[is_lamp].min() >= 0.5 * picture_share * LAMP_RADIANCE > 0
    # To the rounding of float32 weights.
    np.testing.assert_allclose(gathered[(np.diff(table.pair_start) > 0) & ~is_lamp], 1.0, rtol=1e-6)


def test_reflecting_surface_smaller_than_a_pixel_takes_on_nothing(
    furnished_room: RoomMesh, cameras: tuple[CameraModel, ...]
) -> None:
    mesh = with_tiny_lamp(furnished_room, 0.3)
    texels = rasterise_texels(mesh, 240, rasteriser="cpu")
    table = build_gather_table(mesh, texels, cameras)
    assert (np.diff(table.pair_start)[texels.face >= len(furnished_room.faces)] == 0).all()


def test_visibility_is_that_of_brute_force(
    furnished_room: RoomMesh, texels: TexelGeometry, cameras: tuple[CameraModel, ...]
) -> None:
    normals = face_normals(furnished_room)[texels.face]
    sample = np.arange(0, len(texels.face), 7)
    for camera in cameras:
        sight = visible_texels(RoomRays(furnished_room), texels, normals, camera)
        eye = camera.world_from_camera[:3, 3]
        position = texels.position[sample].astype(np.float64) + 1e-6 * normals[sample]
        directions = eye - position
        _, distance = first_face(furnished_room, position, directions)
        facing = (directions * normals[sample]).sum(axis=1) / np.linalg.norm(directions, axis=1) > 0.02
        pixel, valid = project(-directions @ camera.world_from_camera[:3, :3], camera.intrinsics)
        inside = valid & (np.nan_to_num(pixel, nan=-1.0) >= 0).all(axis=1)
        inside &= (np.nan_to_num(pixel, nan=1e9) < camera.intrinsics.width - 1).all(axis=1)
        expected = facing & inside & (distance >= 1)
        found = np.isin(sample, sight.texel)
        # Only texels within the clearance of an occluder's silhouette may differ.
        assert (found != expected).mean() < 1e-3


def test_every_pair_is_a_pixel_that_shows_the_texels_own_surface(
    furnished_room: RoomMesh, texels: TexelGeometry, table: GatherTable, cameras: tuple[CameraModel, ...]
) -> None:
    groups, normals = face_groups(furnished_room), face_normals(furnished_room)
    texel = np.repeat(np.arange(len(texels.face)), np.diff(table.pair_start))
    for index, camera in enumerate(cameras):
        chosen = np.flatnonzero(table.camera == index)[::11]
        width = camera.intrinsics.width
        row, column = np.divmod(table.pixel[chosen].astype(np.int64), width)
        assert row.max() <= camera.intrinsics.height - 2
        assert column.max() <= width - 2
        far_x, far_y = table.fraction_x[chosen] > 0, table.fraction_y[chosen] > 0
        for step_y in (0, 1):
            for step_x in (0, 1):
                used = (far_x | (step_x == 0)) & (far_y | (step_y == 0))
                directions, valid = unproject(
                    np.stack([column + step_x, row + step_y], axis=-1)[used], camera.intrinsics
                )
                assert valid.all()
                world = directions @ camera.world_from_camera[:3, :3].T
                face, _ = first_face(
                    furnished_room, np.broadcast_to(camera.world_from_camera[:3, 3], world.shape), world
                )
                np.testing.assert_array_equal(groups[face], groups[texels.face[texel[chosen[used]]]])
                assert ((normals[face] * world).sum(axis=1) < 0).all()


def test_weights_are_normalised_and_fractions_in_range(texels: TexelGeometry, table: GatherTable) -> None:
    count = np.diff(table.pair_start)
    texel = np.repeat(np.arange(len(texels.face)), count)
    sums = np.bincount(texel, weights=table.weight, minlength=len(count))
    np.testing.assert_allclose(sums[count > 0], 1, atol=1e-6)
    assert (table.weight > 0).all()
    assert (count > 0).mean() > 0.9
    for fraction in (table.fraction_x, table.fraction_y):
        assert fraction.min() >= 0
        assert fraction.max() <= 1
    assert table.pair_start[0] == 0
    assert table.pair_start[-1] == len(table.pixel) == len(table.camera) == len(table.weight)


def test_weights_follow_pixels_per_square_metre(
    furnished_room: RoomMesh, texels: TexelGeometry, table: GatherTable, cameras: tuple[CameraModel, ...]
) -> None:
    normals = face_normals(furnished_room)[texels.face]
    both = np.flatnonzero(np.diff(table.pair_start) == 2)
    start = table.pair_start[both]
    bilinear = (table.fraction_x[start] > 0) & (table.fraction_x[start + 1] > 0)
    both, start = both[bilinear][::53], start[bilinear][::53]
    expected = np.zeros((len(both), 2))
    for index, camera in enumerate(cameras):
        offset = texels.position[both].astype(np.float64) - camera.world_from_camera[:3, 3]
        distance = np.linalg.norm(offset, axis=1)
        cosine = -(offset * normals[both]).sum(axis=1) / distance
        theta = np.arccos(offset @ camera.world_from_camera[:3, 2] / distance)
        # Equidistant lens: f^2 theta / sin(theta) pixels per steradian; the taper is cos(theta) for a 180 degree lens.
        density = camera.intrinsics.fx**2 * theta / np.sin(theta) * cosine / distance**2
        expected[:, index] = density * np.cos(theta)
    expected = expected / expected.max(axis=1, keepdims=True) - MIN_RELATIVE_WEIGHT
    assert expected.min() > 0
    expected /= expected.sum(axis=1, keepdims=True)
    np.testing.assert_array_equal(table.camera[start], 0)
    np.testing.assert_allclose(table.weight[start], expected[:, 0], rtol=1e-5)


def test_unseen_texels_repeat_the_nearest_of_their_surface(
    furnished_room: RoomMesh, texels: TexelGeometry, table: GatherTable
) -> None:
    fill = find_unseen_fill(furnished_room, texels, table)
    seen = np.diff(table.pair_start) > 0
    np.testing.assert_array_equal(fill.texel, np.flatnonzero(~seen))
    # Nothing in this room is black, so every unseen texel finds a seen one.
    assert seen[fill.source].all()
    groups = face_groups(furnished_room)[texels.face]
    has_seen = np.isin(groups[fill.texel], groups[seen])
    np.testing.assert_array_equal(groups[fill.source[has_seen]], groups[fill.texel[has_seen]])
    for index in np.flatnonzero(has_seen)[::37]:
        same = np.flatnonzero(seen & (groups == groups[fill.texel[index]]))
        distances = np.linalg.norm(texels.position[same] - texels.position[fill.texel[index]], axis=1)
        chosen = np.linalg.norm(texels.position[fill.source[index]] - texels.position[fill.texel[index]])
        assert chosen == pytest.approx(distances.min(), abs=1e-6)
    # Nobody sees the underside of the table: it borrows from other surfaces.
    underside = np.abs(texels.position[fill.texel, 1] - 0.66) < 1e-3
    assert underside.any()
    assert not has_seen[underside].any()


def test_unseen_black_surfaces_stay_dark_and_lamps_are_not_copied(
    furnished_room: RoomMesh, texels: TexelGeometry, table: GatherTable
) -> None:
    # Table (1) and both lamps (2, 3) are black.
    albedo = np.array([[0.5] * 3, [0.0] * 3, [0.0] * 3, [0.0] * 3])
    mesh = replace(furnished_room, material_albedo=albedo)
    fill = find_unseen_fill(mesh, texels, table)
    material = mesh.face_material[texels.face]
    underside = np.abs(texels.position[fill.texel, 1] - 0.66) < 1e-3
    assert (fill.source[underside] == -1).all()
    filled = fill.source >= 0
    lends = material[fill.source[filled]] > 0
    np.testing.assert_array_equal(material[fill.texel[filled]][lends], material[fill.source[filled]][lends])


def test_camera_behind_a_surface_sees_nothing_of_it(furnished_room: RoomMesh, texels: TexelGeometry) -> None:
    outside = CameraModel(
        camera_id="outside",
        intrinsics=replace_size(64),
        world_from_camera=np.array([[1.0, 0, 0, 1.5], [0, 1, 0, 1.0], [0, 0, 1, -2.0], [0, 0, 0, 1]]),
    )
    table = build_gather_table(furnished_room, texels, [outside])
    # Every wall turns its black back to it.
    assert len(table.pixel) == 0
    fill = find_unseen_fill(furnished_room, texels, table)
    assert len(fill.texel) == len(texels.face)
    assert (fill.source == -1).all()


def replace_size(size: int):  # type: ignore[no-untyped-def]
    from nearfield_calibration.models import FisheyeIntrinsics

    return FisheyeIntrinsics(
        width=size, height=size, fx=size / np.pi, fy=size / np.pi, cx=(size - 1) / 2, cy=(size - 1) / 2,
        k=(0.0, 0.0, 0.0, 0.0), theta_max=np.pi / 2,
    )  # fmt: skip


def test_far_from_the_origin_the_table_is_the_same(
    furnished_room: RoomMesh, texels: TexelGeometry, table: GatherTable, cameras: tuple[CameraModel, ...]
) -> None:
    shift = np.array([512.0, -256.0, 128.0])
    moved_mesh = replace(furnished_room, positions=furnished_room.positions + shift)
    moved_cameras = []
    for camera in cameras:
        pose = camera.world_from_camera.copy()
        pose[:3, 3] += shift
        moved_cameras.append(replace(camera, world_from_camera=pose))
    moved = build_gather_table(moved_mesh, rasterise_texels(moved_mesh, 240, rasteriser="cpu"), moved_cameras)
    # Texel positions are float32: 3e-5 m at 512 m, which moves a few silhouettes by a texel.
    changed = np.diff(moved.pair_start) != np.diff(table.pair_start)
    assert changed.mean() < 0.01


def test_progress_rises_to_one(
    furnished_room: RoomMesh, texels: TexelGeometry, cameras: tuple[CameraModel, ...]
) -> None:
    parts: list[float] = []
    build_gather_table(furnished_room, texels, cameras, progress=lambda text, part: parts.append(part))
    assert parts == sorted(parts)
    assert parts[-1] == 1.0


def test_no_camera_is_refused(furnished_room: RoomMesh, texels: TexelGeometry) -> None:
    with pytest.raises(ConfigError, match="expected 1 to 255, found 0"):
        build_gather_table(furnished_room, texels, [])

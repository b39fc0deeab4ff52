"""The GLSL light stages against the float64 reference and the processor's kernels, on whatever renderer there is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from nearfield_server.errors import GraphicsError
from nearfield_server.gpu.light_stages import GlBackend, create_light_backend
from nearfield_server.pipeline.backend import BackendSetup, CpuBackend
from nearfield_server.pipeline.hidden_light import find_hidden_light
from nearfield_server.pipeline.packed_table import pack_gather_table, repeat_pairs
from nearfield_server.records import GatherTable, LightSettings, RoomMesh, TexelGeometry
from nearfield_server.reference.box_room import BoxRoom, make_box_room
from nearfield_server.reference.light_stages import ReferenceBackend, packed_gather_reference
from nearfield_server.reference.radiosity import equilibrium_radiance, transport_matrix

pytestmark = pytest.mark.gl

NUM_TEXELS = 5003  # not a multiple of the block size
SHAPES = ((48, 64), (40, 40))


def make_setup(seed: int, split_ratio: float | None) -> BackendSetup:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(NUM_TEXELS, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    texels = TexelGeometry(
        height=80,
        width=80,
        texel_index=np.arange(NUM_TEXELS, dtype=np.int32),
        position=(rng.random((NUM_TEXELS, 3)) * [6.0, 3.0, 4.0]).astype(np.float32),
        normal=normal.astype(np.float32),
        area=rng.uniform(0.5e-4, 2e-4, NUM_TEXELS).astype(np.float32),
        face=np.zeros(NUM_TEXELS, dtype=np.int32),
        lookup=np.full((80, 80), -1, dtype=np.int32),
        gutter_texel=np.zeros(0, dtype=np.int32),
        gutter_source=np.zeros(0, dtype=np.int32),
    )
    count = rng.integers(0, 3, NUM_TEXELS)
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    # Powers of two, which the packed table holds exactly, so that the oracle reads the same weights.
    camera = rng.integers(0, len(SHAPES), start[-1]).astype(np.uint8)
    height, width = np.array(SHAPES)[camera].T
    pixel = rng.integers(0, height - 1) * width + rng.integers(0, width - 1)
    table = GatherTable(
        pair_start=start,
        camera=camera,
        pixel=pixel.astype(np.uint32),
        fraction_x=rng.choice(np.float32([0.0, 0.5, 1.0]), start[-1]),
        fraction_y=rng.choice(np.float32([0.0, 0.5, 1.0]), start[-1]),
        weight=rng.choice(np.float32([0.25, 0.5, 1.0]), start[-1]),
        camera_shapes=SHAPES,
    )
    unseen, seen = np.flatnonzero(count == 0), np.flatnonzero(count > 0)
    mesh = RoomMesh(
        positions=np.zeros((3, 3)),
        normals=np.zeros((3, 3)),
        uv=np.zeros((3, 2)),
        faces=np.array([[0, 1, 2]], dtype=np.int32),
        face_material=np.zeros(1, dtype=np.int32),
        materials=("grey",),
        material_albedo=np.full((1, 3), 0.5),
        uv_source="file",
        content_hash="synthetic",
    )
    return BackendSetup(
        mesh=mesh,
        texels=texels,
        table=table,
        settings=LightSettings(num_vals=12, split_ratio=split_ratio, num_samples=512),
        fill_texels=unseen[: unseen.size // 2].astype(np.int32),
        fill_sources=rng.choice(seen, unseen.size // 2).astype(np.int32),
    )


def pixel_per_texel(unseen: NDArray[np.bool_], width: int) -> GatherTable:
    """A picture that shows every seen texel in a pixel of its own, in texel order; last row and column stay empty."""
    seen = np.flatnonzero(~unseen)
    row, column = np.divmod(seen, width)
    return GatherTable(
        pair_start=np.concatenate([[0], np.cumsum(~unseen)]).astype(np.int64),
        camera=np.zeros(seen.size, dtype=np.uint8),
        pixel=(row * (width + 1) + column).astype(np.uint32),
        fraction_x=np.zeros(seen.size, dtype=np.float32),
        fraction_y=np.zeros(seen.size, dtype=np.float32),
        weight=np.ones(seen.size, dtype=np.float32),
        camera_shapes=((unseen.size // width + 1, width + 1),),
    )


def make_frames(seed: int) -> list[NDArray[np.float16]]:
    rng = np.random.default_rng(seed)
    frames = []
    for camera, (height, width) in enumerate(SHAPES):
        pixels = np.exp(rng.normal(-1.0, 0.4, (height, width, 4)))
        if camera == 0:
            pixels[:6] *= 300.0  # a lamp
        pixels[..., 3] = rng.random((height, width)) > 0.1
        pixels[pixels[..., 3] == 0.0] = 0.0
        frames.append(pixels.astype(np.float16))
    return frames


@pytest.fixture(scope="module", params=[None, 0.6], ids=["auto", "ratio"])
def backends(request: pytest.FixtureRequest) -> Iterator[tuple[GlBackend, CpuBackend, ReferenceBackend]]:
    setup = make_setup(7, request.param)
    gl = create_light_backend(setup, allow_software=True)
    yield gl, CpuBackend(setup), ReferenceBackend(setup)
    gl.release()


def test_software_renderers_are_refused_unless_asked_for() -> None:
    gl = create_light_backend(make_setup(1, None), allow_software=True)
    is_software = gl.is_software
    gl.release()
    if not is_software:
        pytest.skip("this machine has a real GPU")
    with pytest.raises(GraphicsError, match="software"):
        create_light_backend(make_setup(1, None), allow_software=False)


def test_every_stage_agrees_with_the_float64_reference(
    backends: tuple[GlBackend, CpuBackend, ReferenceBackend],
) -> None:
    gl, _, reference = backends
    frames = make_frames(3)
    for backend in backends:
        backend.gather(frames)
    truth = reference.texel_radiance().astype(np.float64)
    np.testing.assert_allclose(gl.texel_radiance(), truth, rtol=3e-6, atol=1e-7)

    thresholds = [backend.split() for backend in backends]
    # The neighbouring float at most: float32 partial sums may decide a tie of ranks differently.
    np.testing.assert_allclose(thresholds[0], thresholds[2], rtol=2e-4)
    np.testing.assert_allclose(thresholds[0], thresholds[1], rtol=2e-4)

    points = [backend.sample() for backend in backends]
    assert points[0].shape == points[2].shape
    same = np.all(np.abs(points[0] - points[2]) < 1e-6, axis=1)
    assert same.mean() > 0.99, "samples differ beyond ties at the border of two texels"

    centres = points[2][:: points[2].shape[0] // 12][:12]
    alive = np.ones(12, dtype=np.bool_)
    alive[5] = False
    ours, oracle = gl.integrate(centres, alive), reference.integrate(centres, alive)
    np.testing.assert_allclose(ours.radiant_intensity, oracle.radiant_intensity, rtol=2e-3, atol=1e-9)
    np.testing.assert_allclose(
        ours.radiant_intensity.sum(axis=0), oracle.radiant_intensity.sum(axis=0), rtol=1e-3
    )
    np.testing.assert_allclose(ours.position, oracle.position, atol=2e-3)
    np.testing.assert_allclose(ours.normal, oracle.normal, atol=2e-3)
    np.testing.assert_allclose(ours.area, oracle.area, rtol=5e-3, atol=1e-6)
    assert not ours.radiant_intensity[5].any()

    probe = np.random.default_rng(5).integers(-1, NUM_TEXELS, 6 * 16 * 16).astype(np.int32)
    sh = [backend.project_sh(probe, 16) for backend in backends]
    np.testing.assert_allclose(sh[0], sh[2], atol=2e-3 * np.abs(sh[2]).max())


def test_direct_energy_is_kept_for_equal_thresholds(
    backends: tuple[GlBackend, CpuBackend, ReferenceBackend],
) -> None:
    gl, _, _ = backends
    gl.gather(make_frames(4))
    threshold = gl.split()
    radiance = gl.texel_radiance().astype(np.float64)
    area = make_setup(7, None).texels.area.astype(np.float64)
    points = gl.sample()
    sums = gl.integrate(points[:12], np.ones(12, dtype=np.bool_))
    direct = np.where(radiance >= threshold, radiance, 0.0) * area[:, None]
    np.testing.assert_allclose(sums.radiant_intensity.sum(axis=0), direct.sum(axis=0), rtol=1e-6)


def test_black_pictures_have_no_direct_light(
    backends: tuple[GlBackend, CpuBackend, ReferenceBackend],
) -> None:
    gl, _, _ = backends
    gl.gather([np.zeros((*shape, 4), dtype=np.float16) for shape in SHAPES])
    assert np.all(np.isinf(gl.split()))
    assert gl.sample().shape == (0, 6)


def test_any_weights_are_read_as_they_are_packed() -> None:
    setup = make_setup(8, None)
    rng = np.random.default_rng(8)
    count = setup.table.pixel.size
    table = replace(
        setup.table,
        fraction_x=rng.random(count, dtype=np.float32),
        fraction_y=rng.random(count, dtype=np.float32),
        weight=rng.uniform(0.01, 1.0, count).astype(np.float32),
    )
    gl = create_light_backend(replace(setup, table=table), allow_software=True)
    frames = make_frames(8)
    gl.gather(frames)
    radiance = gl.texel_radiance()
    gl.release()
    filled = repeat_pairs(table, setup.fill_texels, setup.fill_sources)
    expected = packed_gather_reference(pack_gather_table(filled), frames)
    np.testing.assert_allclose(radiance, expected, rtol=3e-6, atol=1e-7)


def test_a_missing_camera_is_left_out(backends: tuple[GlBackend, CpuBackend, ReferenceBackend]) -> None:
    gl, _, reference = backends
    frames = make_frames(9)
    for backend in (gl, reference):
        backend.gather([None, frames[1]])
    np.testing.assert_allclose(gl.texel_radiance(), reference.texel_radiance(), rtol=3e-6, atol=1e-7)


def test_broken_pixels_do_not_spread(backends: tuple[GlBackend, CpuBackend, ReferenceBackend]) -> None:
    gl, _, _ = backends
    frames = make_frames(10)
    frames[0][5:9, 5:9, :3] = np.nan
    frames[1][5:9, 5:9, 0] = np.inf
    frames[1][9:12, 5:9, 1] = -3.0
    gl.gather(frames)
    radiance = gl.texel_radiance()
    assert np.all(np.isfinite(radiance))
    assert np.all(radiance >= 0.0)


@pytest.fixture(scope="module")
def room_with_hidden_lamps() -> tuple[BoxRoom, BackendSetup, NDArray[np.bool_], NDArray[np.bool_]]:
    """A box room with two squares of the ceiling that no camera sees; the room, and the texels of both squares."""
    room = make_box_room(atlas_size=60, num_cameras=1, camera_size=16)
    position, on_ceiling = room.texels.position, room.texels.normal[:, 1] < -0.5
    squares = [
        on_ceiling & (np.abs(position[:, 0] - x) < 0.35) & (np.abs(position[:, 2] - 2.0) < 0.35)
        for x in (1.5, 3.0)
    ]
    # One square has a material of its own, and so the two are not one surface.
    mesh = room.mesh()
    texels = replace(
        room.texels, face=np.where(squares[1], mesh.faces.shape[0], room.texels.face).astype(np.int32)
    )
    mesh = replace(
        mesh,
        faces=np.concatenate([mesh.faces, mesh.faces[6:7]]),
        face_material=np.append(mesh.face_material, np.int32(1)),
        materials=("wall", "panel"),
        material_albedo=np.full((2, 3), 0.5),
    )
    unseen = squares[0] | squares[1]
    hidden = find_hidden_light(mesh, texels, unseen, room)
    assert hidden is not None
    assert hidden.num_groups == 2
    none = np.zeros(0, dtype=np.int32)
    setup = BackendSetup(
        mesh=mesh,
        texels=texels,
        table=pixel_per_texel(unseen, room.resolution[0]),
        settings=LightSettings(num_vals=12, num_samples=512),
        fill_texels=none,
        fill_sources=none,
        hidden=hidden,
    )
    return room, setup, squares[0], squares[1]


def test_hidden_lamps_shine_alike_on_all_backends(
    room_with_hidden_lamps: tuple[BoxRoom, BackendSetup, NDArray[np.bool_], NDArray[np.bool_]],
) -> None:
    """The first square goes on, brighter, off; the second never shines. Bounced light is in equilibrium."""
    room, setup, lamp, dark = room_with_hidden_lamps
    area = room.texels.area.astype(np.float64)
    transport = transport_matrix(room.texels)
    seen_lamp = (room.texels.normal[:, 1] < -0.5) & (np.abs(room.texels.position[:, 0] - 4.8) < 0.35)
    seen_lamp &= np.abs(room.texels.position[:, 2] - 2.0) < 0.35
    albedo = np.where(seen_lamp | lamp, 0.0, 0.5)[:, None]
    gl = create_light_backend(setup, allow_software=True)
    backends = (gl, CpuBackend(setup), ReferenceBackend(setup))
    try:
        for colour in ((20.0, 18.0, 15.0), (90.0, 120.0, 150.0), (0.0, 0.0, 0.0)):
            emitted = np.zeros((area.size, 3))
            emitted[seen_lamp], emitted[lamp] = (20.0, 18.0, 15.0), colour
            light = equilibrium_radiance(transport, emitted, albedo)

            rows, columns = setup.table.camera_shapes[0]
            picture = np.zeros((rows, columns, 4), dtype=np.float16)
            picture[:-1, :-1, :3] = light.reshape(rows - 1, columns - 1, 3)
            picture[:-1, :-1, 3] = 1.0
            for backend in backends:
                backend.gather([picture])
            truth = backends[2].texel_radiance()
            np.testing.assert_allclose(truth[lamp], np.tile(colour, (lamp.sum(), 1)), rtol=0.1)
            assert not truth[dark].any()
            for backend in backends[:2]:
                np.testing.assert_allclose(backend.texel_radiance(), truth, rtol=2e-5, atol=1e-6)

            thresholds = [backend.split() for backend in backends]
            np.testing.assert_allclose(thresholds[0], thresholds[2], rtol=2e-4)
            np.testing.assert_allclose(thresholds[1], thresholds[2], rtol=2e-4)
            points = backends[2].sample()
            sums = [backend.integrate(points[:12], np.ones(12, dtype=np.bool_)) for backend in backends]
            for ours in sums:
                np.testing.assert_allclose(
                    ours.radiant_intensity.sum(axis=0),
                    ((emitted[seen_lamp].T * area[seen_lamp]).sum(axis=1) + truth[lamp].T @ area[lamp]),
                    rtol=1e-3,
                )
    finally:
        gl.release()

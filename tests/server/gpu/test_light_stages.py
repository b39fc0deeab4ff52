"""The GLSL light stages against the float64 reference and the processor's kernels, on whatever renderer there is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from nearfield_server.errors import GraphicsError
from nearfield_server.gpu.light_stages import GlBackend, create_light_backend
from nearfield_server.pipeline.backend import BackendSetup, CpuBackend
from nearfield_server.records import GatherTable, LightSettings, RoomMesh, TexelGeometry
from nearfield_server.reference.light_stages import ReferenceBackend

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
    # Values that the packed table holds exactly, so that the oracle reads the same weights.
    camera = rng.integers(0, len(SHAPES), start[-1]).astype(np.uint8)
    height, width = np.array(SHAPES)[camera].T
    pixel = rng.integers(0, height - 1) * width + rng.integers(0, width - 1)
    table = GatherTable(
        pair_start=start,
        camera=camera,
        pixel=pixel.astype(np.uint32),
        fraction_x=(rng.integers(0, 256, start[-1]) / 255.0).astype(np.float32),
        fraction_y=(rng.integers(0, 256, start[-1]) / 255.0).astype(np.float32),
        weight=(rng.integers(9000, 65536, start[-1]) / 65535.0).astype(np.float32),
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

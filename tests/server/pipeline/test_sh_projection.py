import numpy as np
import pytest

from nearfield_server.pipeline.sh_projection import project_indirect, weighted_basis
from nearfield_server.radiometry.cube import cube_directions, cube_solid_angles
from nearfield_server.radiometry.sh import irradiance, project_samples
from nearfield_server.reference.box_room import BoxRoom
from nearfield_server.reference.direct_light import direct_sum_irradiance

INFINITE = np.full(3, np.inf, dtype=np.float32)


def test_white_furnace(room: BoxRoom) -> None:
    radiance = np.ones((room.texels.area.size, 3), dtype=np.float32)
    coeffs = project_indirect(room.trace(np.array([1.0, 1.0, 1.0]), 32), 32, radiance, INFINITE)
    np.testing.assert_allclose(coeffs[0], np.sqrt(4.0 * np.pi), rtol=1e-12)
    np.testing.assert_allclose(coeffs[1:], 0.0, atol=2e-3)
    np.testing.assert_allclose(irradiance(coeffs, cube_directions(1)), np.pi, rtol=3e-3)


@pytest.mark.parametrize("resolution", [1, 8, 64])
def test_matches_float64(room: BoxRoom, resolution: int) -> None:
    rng = np.random.default_rng(resolution)
    radiance = rng.exponential(size=(room.texels.area.size, 3)).astype(np.float32)
    threshold = np.array([1.0, np.inf, 0.3], dtype=np.float32)
    probe = room.trace(np.array([2.0, 0.5, 3.0]), resolution)
    probe[rng.random(probe.size) < 0.1] = -1
    indirect = np.where((radiance < threshold)[probe] & (probe >= 0)[:, None], radiance[probe], 0.0)
    expected = project_samples(cube_directions(resolution), cube_solid_angles(resolution), indirect)
    np.testing.assert_allclose(
        project_indirect(probe, resolution, radiance, threshold), expected, rtol=1e-10, atol=1e-12
    )


def test_direct_and_indirect_add_up(room: BoxRoom) -> None:
    radiance = np.random.default_rng(1).exponential(size=(room.texels.area.size, 3)).astype(np.float32)
    threshold = np.full(3, 0.7, dtype=np.float32)
    probe = room.trace(np.array([2.0, 0.5, 3.0]), 16)
    direct = np.where(radiance >= threshold, radiance, 0.0).astype(np.float32)
    total = project_indirect(probe, 16, radiance, INFINITE)
    parts = project_indirect(probe, 16, radiance, threshold) + project_indirect(probe, 16, direct, INFINITE)
    np.testing.assert_allclose(parts, total, rtol=1e-12, atol=1e-13)


def test_smooth_light_gives_the_irradiance_of_the_direct_sum(room: BoxRoom) -> None:
    position = room.texels.position.astype(np.float64) / room.size
    radiance = (1.0 + position @ np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])).astype(np.float32)
    centre = np.array([3.0, 1.5, 2.0])
    normals = cube_directions(1)
    expected = direct_sum_irradiance(room.texels, radiance, np.repeat(centre[None], 6, 0), normals)
    coeffs = project_indirect(room.trace(centre, 64), 64, radiance, INFINITE)
    np.testing.assert_allclose(irradiance(coeffs, normals), expected, rtol=0.02)


def test_basis_is_made_once() -> None:
    assert weighted_basis(16) is weighted_basis(16)


def test_refuses_a_probe_of_another_resolution(room: BoxRoom) -> None:
    radiance = np.ones((room.texels.area.size, 3), dtype=np.float32)
    with pytest.raises(ValueError, match="1536"):
        project_indirect(np.zeros(6, dtype=np.int32), 16, radiance, INFINITE)

import numpy as np
import pytest

from nearfield_server.benchmark.methods.median_cut import LatLongGrid, median_cut
from nearfield_server.radiometry.cube import cube_directions
from nearfield_server.radiometry.sh import sh_basis

GRID = LatLongGrid.make(32)


def test_the_grid_covers_the_sphere() -> None:
    assert GRID.solid_angles.sum() == pytest.approx(4.0 * np.pi, rel=1e-12)
    np.testing.assert_allclose(np.linalg.norm(GRID.directions, axis=1), 1.0, rtol=1e-12)
    gram = sh_basis(GRID.directions).T @ (sh_basis(GRID.directions) * GRID.solid_angles[:, None])
    np.testing.assert_allclose(gram, np.eye(9), atol=5e-3)


def test_every_pixel_finds_the_cube_pixel_behind_it() -> None:
    found = cube_directions(16)[GRID.cube_pixels(16)]
    cosine = (found * GRID.directions).sum(axis=1)
    assert cosine.min() > np.cos(np.radians(6.0))


@pytest.mark.parametrize("count", [1, 2, 8, 64])
def test_regions_share_sphere_and_light(count: int) -> None:
    radiance = np.random.default_rng(1).random((len(GRID.directions), 3))
    regions = median_cut(GRID, radiance, count)
    assert len(regions) == count
    assert sum(region.solid_angle for region in regions) == pytest.approx(4.0 * np.pi)
    energy = np.array([region.irradiance for region in regions])
    np.testing.assert_allclose(
        energy.sum(axis=0), (radiance * GRID.solid_angles[:, None]).sum(axis=0), rtol=1e-12
    )
    # Equal up to the width of a line of pixels, over and over.
    grey = energy.mean(axis=1)
    assert grey.max() < 2.0 * grey.min()


def test_a_bright_spot_keeps_its_direction() -> None:
    target = np.array([0.48, 0.6, -0.64])
    near = GRID.directions @ target > 0.995
    radiance = np.where(near[:, None], 1000.0, 1e-3) * np.ones(3)
    brightest = max(median_cut(GRID, radiance, 4), key=lambda region: float(region.irradiance.sum()))
    assert brightest.direction @ target > 0.99


def test_black_holds_no_regions_and_odd_numbers_are_refused() -> None:
    black = np.zeros((len(GRID.directions), 3))
    assert median_cut(GRID, black, 8) == []
    with pytest.raises(ValueError, match="asked for 12"):
        median_cut(GRID, black, 12)

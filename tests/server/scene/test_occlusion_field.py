"""Laws of the occlusion field: solid angle of a sphere, no leak from inside, bounds."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from nearfield_server.radiometry.sh import sh_basis
from nearfield_server.scene.occlusion_field import compute_occlusion_field


@pytest.fixture(scope="module")
def sphere_field():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    positions = np.asarray(sphere.vertices) + np.array([1.0, 2.0, 3.0])
    return compute_occlusion_field(positions, np.asarray(sphere.faces), num_rays=2048)


def centres(field):
    nx, ny, nz = field.resolution
    z, y, x = np.meshgrid(*((np.arange(n) + 0.5) / n for n in (nz, ny, nx)), indexing="ij")
    return field.box_min + field.box_size * np.stack([x, y, z], axis=-1)


def test_outside_a_sphere_the_field_is_that_of_its_cone(sphere_field):
    # O is 1 in a cone of half angle asin(r / d): zonal coefficients in closed form.
    offset = np.array([1.0, 2.0, 3.0]) - centres(sphere_field)
    distance = np.linalg.norm(offset, axis=-1)
    # Grazing cells differ by the tessellation of the sphere.
    outside = distance > 0.55
    cosine = np.sqrt(1 - (0.5 / distance[outside]) ** 2)
    zonal = np.stack(
        [2 * np.pi * (1 - cosine), np.pi * (1 - cosine**2), np.pi * cosine * (1 - cosine**2)], axis=-1
    )
    band = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2])
    expected = zonal[:, band] * sh_basis(offset[outside] / distance[outside][:, None])
    found = sphere_field.coeffs[outside][:, :9].astype(np.float64)
    assert np.abs(found - expected).max() < 0.12
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.02


def test_cells_inside_repeat_a_cell_outside(sphere_field):
    distance = np.linalg.norm(centres(sphere_field) - [1.0, 2.0, 3.0], axis=-1)
    share = sphere_field.coeffs[..., 0].astype(np.float64) / np.sqrt(4 * np.pi)
    assert (distance < 0.45).any()
    assert share.max() < 0.51
    # The nearest centre outside is less than a cell (0.1) above the surface.
    assert share[distance < 0.45].min() > (1 - np.sqrt(1 - (0.5 / 0.6) ** 2)) / 2


def test_layout(sphere_field):
    nx, ny, nz = sphere_field.resolution
    assert sphere_field.coeffs.shape == (nz, ny, nx, 12)
    assert sphere_field.coeffs.dtype == np.float16
    assert not sphere_field.coeffs[..., 9:].any()
    assert max(nx, ny, nz) == 20


def test_sampling_returns_the_cells_at_their_centres_and_nothing_outside(sphere_field):
    points = centres(sphere_field)
    np.testing.assert_allclose(
        sphere_field.sample(points.reshape(-1, 3)).reshape((*points.shape[:-1], 9)),
        sphere_field.coeffs[..., :9].astype(np.float64),
        atol=1e-6,
    )
    outside = sphere_field.box_min - 0.1
    assert not sphere_field.sample(outside[None]).any()


def test_flat_objects_get_fewer_cells_across_and_a_layer_just_below():
    box = trimesh.creation.box(extents=(1.0, 0.05, 0.2))
    field = compute_occlusion_field(np.asarray(box.vertices), np.asarray(box.faces), num_rays=64)
    nx, ny, nz = field.resolution
    assert nx == 20
    assert ny < nx
    assert nz < nx
    heights = field.box_min[1] + field.box_size[1] * (np.arange(ny) + 0.5) / ny
    below = -0.025 - heights
    assert np.min(below[below > 0]) < 0.05 * field.box_size[1] / ny


def test_on_the_floor_under_an_object_the_sky_is_gone():
    box = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    field = compute_occlusion_field(np.asarray(box.vertices), np.asarray(box.faces), num_rays=1024)
    # Cosine about +y in band-limited form: A_l Y_k(0, 1, 0).
    up = np.array([np.pi] + [2 * np.pi / 3] * 3 + [np.pi / 4] * 5) * sh_basis(np.array([0.0, 1.0, 0.0]))
    middle = field.sample(np.array([[0.0, -0.5 - 1e-3, 0.0]]))[0]
    assert up @ middle / np.pi == pytest.approx(1.0, abs=0.03)

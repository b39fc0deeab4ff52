"""The irradiance that a packet stands for: closed forms, visibility, self-interreflection."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from nearfield_protocol.codec import VAL_DTYPE
from nearfield_server.evaluation import irradiance
from nearfield_server.evaluation.irradiance import PlacedObject, estimate_irradiance, make_caster
from nearfield_server.radiometry.form_factor import disc_irradiance_on_axis
from nearfield_server.radiometry.sh import sh_basis
from nearfield_server.scene.occlusion_field import compute_occlusion_field
from nearfield_server.scene.prepared_model import PreparedModel
from nearfield_server.scene.ray_caster import RayCaster
from nearfield_server.scene.shadow_proxy import make_shadow_proxy
from nearfield_server.scene.transfer import compute_transfer


def placed(mesh, world_from_object=None, albedo=0.5, samples=400):
    positions, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    normals = np.asarray(mesh.vertex_normals, np.float64)
    model = PreparedModel(
        positions=positions.astype(np.float32),
        normals=normals.astype(np.float32),
        faces=faces.astype(np.int32),
        albedo=np.full(3, albedo),
        transfer=compute_transfer(positions, normals, faces, samples_per_vertex=samples),
        ground_shadow=np.zeros((len(positions), 9)),
        proxy=make_shadow_proxy(positions, faces),
        occlusion_field=compute_occlusion_field(positions, faces, max_resolution=4, num_rays=16),
        centre=np.zeros(3),
        radius=1.0,
        preset="preview",
        source_hash="",
    )
    pose = np.eye(4) if world_from_object is None else world_from_object
    return PlacedObject(model=model, albedo=np.full(3, albedo), world_from_object=pose)


def val(position, normal, intensity, area):
    record = np.zeros(1, VAL_DTYPE)
    record["position"], record["normal"] = position, normal
    record["radiant_intensity"], record["area"] = intensity, area
    return record


FAR_ROOM = (np.array([[-50.0, -50, -50], [50, -50, -50], [0, -50, 50]]), np.array([[0, 2, 1]]))


def estimate(item, vals, sh, points, normals):
    return estimate_irradiance(
        points,
        normals,
        np.zeros(len(points), np.int64),
        vals=vals,
        object_sh=sh,
        objects=[item],
        caster=make_caster(*FAR_ROOM, [item]),
        room_caster=make_caster(*FAR_ROOM, []),
        room_albedo=np.full((1, 3), 0.5),
    )


def test_a_convex_object_under_a_disc_on_its_axis_has_the_closed_form():
    sphere = placed(trimesh.creation.icosphere(subdivisions=3, radius=0.1))
    top = int(np.argmax(sphere.model.positions[:, 1]))
    radius, radiance, height = 0.4, 3.0, 0.7
    area = np.pi * radius**2
    light = val([0, 0.1 + height, 0], [0, -1, 0], radiance * area, area)
    parts = estimate(
        sphere, light, np.zeros((1, 9, 3)), sphere.model.positions[[top]], np.array([[0.0, 1.0, 0.0]])
    )
    expected = disc_irradiance_on_axis(height - (sphere.model.positions[top, 1] - 0.1), radius, radiance)
    np.testing.assert_allclose(parts.direct[0], expected, rtol=1e-6)
    assert not parts.bounced.any()
    bottom = int(np.argmin(sphere.model.positions[:, 1]))
    dark = estimate(
        sphere, light, np.zeros((1, 9, 3)), sphere.model.positions[[bottom]], np.array([[0.0, -1.0, 0.0]])
    )
    assert not dark.direct.any()


def test_constant_light_on_a_rotated_convex_object_is_pi():
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [0.1, 0, 0])
    sphere = placed(trimesh.creation.icosphere(subdivisions=2, radius=0.2), turn)
    sh = np.zeros((1, 9, 3))
    sh[0, 0] = np.sqrt(4 * np.pi) * np.array([1.0, 2.0, 3.0])
    normals = sphere.model.normals @ turn[:3, :3].T
    parts = estimate(sphere, np.zeros(4, VAL_DTYPE), sh, sphere.positions_world, normals)
    np.testing.assert_allclose(parts.total, np.pi * np.tile([1.0, 2, 3], (len(normals), 1)), rtol=1e-5)


def test_light_from_one_side_stays_on_that_side_when_the_object_turns():
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    sphere = placed(trimesh.creation.icosphere(subdivisions=2, radius=0.2), turn)
    sh = np.zeros((1, 9, 3))
    sh[0] = sh_basis(np.array([0.0, 1.0, 0.0]))[:, None]
    normals = sphere.model.normals @ turn[:3, :3].T
    parts = estimate(sphere, np.zeros(0, VAL_DTYPE), sh, sphere.positions_world, normals)
    assert np.argmax(parts.indirect[:, 0]) == np.argmax(normals[:, 1])


def test_half_a_disc_behind_a_wall_gives_half_the_light():
    wall = np.array([[0.0, -5, 0.5], [5, -5, 0.5], [5, 5, 0.5], [0, 5, 0.5]])
    caster = RayCaster(wall, np.array([[0, 1, 2], [0, 2, 3]]))
    targets = irradiance.disc_points(val([0, 0, 1.0], [0, 0, -1], 1.0, 0.2)[0], 256)
    assert irradiance.visible_part(np.zeros((1, 3)), targets, caster)[0] == pytest.approx(0.5, abs=0.02)


def test_disc_points_cover_the_circle_within_the_square_of_the_same_second_moment():
    light = val([1, 2, 3], [0.6, 0, 0.8], 1.0, 0.5)[0]
    points = irradiance.disc_points(light, 1000) - np.array([1.0, 2.0, 3.0])
    # A disc of area A has the moment A / (2 pi) of a square of half side h where 2 h^2 / 3 = A / (2 pi): h = sqrt(3) / 2 radius.
    radius = np.sqrt(3.0) / 2.0 * np.sqrt(0.5 / np.pi)
    assert np.abs(points @ np.array([0.6, 0, 0.8])).max() < 1e-6
    distance = np.linalg.norm(points, axis=1)
    assert distance.max() < radius
    assert np.mean(distance**2) == pytest.approx(radius**2 / 2, rel=1e-3)
    assert np.abs(points.mean(axis=0)).max() < 0.01


def test_bounced_light_of_a_far_val_is_that_of_the_same_light_in_sh():
    # A VAL so far away that it is one direction: its light through the bounce part must equal that part times SH of the direction.
    torus = placed(trimesh.creation.torus(0.5, 0.2, major_sections=12, minor_sections=8), albedo=0.8)
    direction = np.array([0.0, 0.6, 0.8])
    distance, facing_irradiance = 30.0, 2.0
    light = val(direction * distance, -direction, facing_irradiance * distance**2, 0.0)
    points, normals = torus.model.positions.astype(np.float64), torus.model.normals.astype(np.float64)
    parts = estimate(torus, light, np.zeros((1, 9, 3)), points, normals)
    bounce = torus.model.transfer.total(0.8) - torus.model.transfer.shadowed
    expected = facing_irradiance * bounce @ sh_basis(direction)
    np.testing.assert_allclose(parts.bounced[:, 0], expected, rtol=1e-4, atol=1e-9)


def test_interpolation_takes_vertices_by_position_and_normal_and_faces_elsewhere():
    box = trimesh.creation.box(extents=(0.2, 0.2, 0.2))
    flat = trimesh.Trimesh(
        box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    )
    model = placed(flat).model
    vertices, weights = irradiance.interpolation(
        model, model.positions.astype(np.float64), model.normals.astype(np.float64)
    )
    np.testing.assert_allclose(model.positions[vertices[:, 0]], model.positions, atol=1e-7)
    np.testing.assert_allclose(model.normals[vertices[:, 0]], model.normals, atol=1e-7)
    np.testing.assert_array_equal(weights, np.tile([1.0, 0, 0], (36, 1)))
    inner, normal = np.array([[0.1, 0.02, -0.03]]), np.array([[1.0, 0, 0]])
    vertices, weights = irradiance.interpolation(model, inner, normal)
    np.testing.assert_allclose(
        np.einsum("pc,pck->pk", weights, model.positions[vertices].astype(np.float64)), inner, atol=1e-6
    )


def test_error_numbers_of_known_errors():
    truth = np.array([[1.0, 1, 1], [3, 3, 3]])
    assert irradiance.rel_rmse(truth + 0.2, truth) == pytest.approx(0.1)
    assert irradiance.bias(truth - 0.2, truth) == pytest.approx(-0.1)
    assert irradiance.median_rel(truth + np.array([[0.2], [-0.4]]), truth) == pytest.approx(0.15)

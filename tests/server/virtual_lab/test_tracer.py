"""The estimator against closed forms, an independent path tracer and conservation laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from nearfield_server.virtual_lab.backend import Backend
from nearfield_server.virtual_lab.checks import compare_with_path
from nearfield_server.virtual_lab.geometry import build_cells, build_geometry
from nearfield_server.virtual_lab.model import Light, Quad, Scene
from nearfield_server.virtual_lab.radiosity import solve_radiosity
from nearfield_server.virtual_lab.render import (
    camera_directions,
    pixels_in_circle,
    point_irradiance,
    render_image,
)
from nearfield_server.virtual_lab.shapes import FACES, box_face, quad, with_cell_size
from nearfield_server.virtual_lab.tracer import Tracer

pytestmark = pytest.mark.lab


def polygon_irradiance(point: NDArray[np.float64], normal: NDArray[np.float64], emitter: Quad) -> float:
    """Lambert's formula: irradiance from a polygon of unit radiance that lies wholly above the horizon."""
    corners = emitter.p0 + np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) @ np.stack([emitter.e1, emitter.e2])
    directions = corners - point
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    total = 0.0
    for first, second in zip(directions, np.roll(directions, -1, axis=0), strict=True):
        axis = np.cross(first, second)
        angle = np.arctan2(np.linalg.norm(axis), first @ second)
        total += float(angle * (axis / np.linalg.norm(axis)) @ normal)
    return abs(total) / 2


def closed_box(albedo: float, emitter: Quad) -> Scene:
    """A box of 2 x 2 x 2 m with one emitter inside and no objects."""
    walls = [box_face((0, 0, 0), (2, 2, 2), face, "wall", inward=True) for face in FACES]
    return Scene(
        name="box",
        size=(2.0, 2.0, 2.0),
        materials={"wall": (albedo, albedo, albedo), "emit": (0.0, 0.0, 0.0)},
        quads=(*with_cell_size(walls, 0.1), emitter),
        lights=(Light(name="light", kind="test", radiance=(1.0, 1.0, 1.0)),),
        objects=(),
        cameras=(),
        views=(),
    )


@pytest.mark.parametrize(
    ("width", "height"),
    [(0.02, 0.02), (0.4, 0.02), (0.4, 0.4), (1.6, 1.2)],
    ids=["tiny", "strip", "panel", "window"],
)
def test_direct_irradiance_matches_lamberts_formula(backend: Backend, width: float, height: float) -> None:
    emitter = quad((1 - width / 2, 1.99, 1 - height / 2), (width, 0, 0), (0, 0, height), "emit", light=0)
    scene = closed_box(0.0, emitter)
    tracer = Tracer(backend, scene, build_geometry(scene, with_objects=False))
    tracer.set_cache(np.zeros((build_geometry(scene, with_objects=False).num_cells, 1, 3)))
    points = np.array([[1.0, 0.0, 1.0], [0.3, 0.0, 1.7], [0.1, 0.0, 0.1], [1.0, 0.0, 1.9]])
    normals = np.tile([0.0, 1.0, 0.0], (4, 1))
    result = point_irradiance(tracer, points, normals, replicas=64, samples=64, gather_rays=1, seed=1)
    expected = [polygon_irradiance(p, n, emitter) for p, n in zip(points, normals, strict=True)]
    np.testing.assert_allclose(result.direct.mean(axis=0)[:, 0], expected, rtol=2e-3)
    assert not result.indirect.any()


def test_closed_box_conserves_flux(backend: Backend) -> None:
    """What the walls absorb is what the emitter sends: sum (1 - albedo) E A = pi L A_emitter."""
    emitter = quad((0.8, 1.999, 0.8), (0.4, 0, 0), (0, 0, 0.4), "emit", light=0)
    for albedo in (0.3, 0.8):
        scene = closed_box(albedo, emitter)
        geometry = build_geometry(scene, with_objects=False)
        cells, tracer = build_cells(scene, geometry), Tracer(backend, scene, geometry)
        cache = solve_radiosity(tracer, cells, points=64, rays_per_point=4, seed=3)
        irradiance = cache.direct[:, 0] + cache.indirect[:, 0, 1]
        absorbed = np.sum((1 - cells.albedo[:, 1]) * irradiance * cells.area)
        assert absorbed == pytest.approx(np.pi * 0.16, rel=0.01)


def test_estimator_agrees_with_a_path_tracer(backend: Backend, tiny_scene: Scene) -> None:
    """Mitsuba's `path` integrator shares only the ray caster. Flat normals: it blacks out smooth ones that face away from a ray."""
    flat = tuple(
        replace(
            item,
            positions=item.positions[item.faces].reshape(-1, 3),
            faces=np.arange(item.faces.size, dtype=np.int32).reshape(-1, 3),
            normals=np.repeat(face_normals(item.positions, item.faces), 3, axis=0),
        )
        for item in tiny_scene.objects
    )
    comparison = compare_with_path(
        backend,
        replace(tiny_scene, objects=flat),
        room_points=160,
        object_points=64,
        replicas=32,
        samples=64,
        cell_points=64,
    )
    for selected in (comparison.is_object, ~comparison.is_object):
        summary = comparison.summary(selected)
        assert summary["points"] >= 60
        # four standard errors, plus half a percent for the radiosity cells of up to 5 cm
        assert abs(summary["ratio"] - 1) < 4 * summary["ratio_error"] + 0.005
        assert summary["rms_z"] < 1.5


def face_normals(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    corner = positions[faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.asarray(cross / np.linalg.norm(cross, axis=1, keepdims=True))


def test_camera_rays_project_back_to_their_pixels(backend: Backend, tiny_scene: Scene) -> None:
    mi = backend.mi
    tracer = Tracer(backend, tiny_scene, build_geometry(tiny_scene, with_objects=False))
    for sensor in (*tiny_scene.cameras, *tiny_scene.views):
        pixel = pixels_in_circle(sensor)
        column, row = pixel % sensor.width, pixel // sensor.width
        rays = camera_directions(
            tracer, sensor, mi.Float(column.astype(np.float32)), mi.Float(row.astype(np.float32))
        )
        local = rays.numpy().T.astype(np.float64) @ sensor.world_from_camera[:3, :3]
        theta = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2])
        phi = np.arctan2(local[:, 1], local[:, 0])
        if sensor.is_fisheye:
            radius = theta * (1 + sum(c * theta ** (2 * n + 2) for n, c in enumerate(sensor.k)))
            assert theta.max() <= sensor.theta_max + 1e-5
        else:
            radius = np.tan(theta)
        np.testing.assert_allclose(
            sensor.cx + sensor.fx * radius * np.cos(phi), column, atol=2e-4 * sensor.width
        )
        np.testing.assert_allclose(
            sensor.cy + sensor.fy * radius * np.sin(phi), row, atol=2e-4 * sensor.width
        )


def test_pictures_with_and_without_objects_share_their_noise(backend: Backend, tiny_scene: Scene) -> None:
    """Where the objects change nothing, pictures differ by far less than their own noise."""
    view = tiny_scene.views[0]
    images = []
    for flag in (False, True):
        geometry = build_geometry(tiny_scene, with_objects=flag)
        tracer = Tracer(backend, tiny_scene, geometry)
        cells = build_cells(tiny_scene, geometry)
        tracer.set_cache(
            solve_radiosity(tracer, cells, points=8, rays_per_point=4, seed=1).reflected_radiance
        )
        images.append(render_image(tracer, view, samples=4, gather_rays=4, seed=9))
    background, composite = images
    first, second = background.total_halves
    noise = np.abs(first - second).mean(axis=(0, -1))
    change = np.abs(composite.total_halves - background.total_halves).mean(axis=(0, 1, -1))
    untouched = composite.coverage == 0
    assert np.median(change[untouched]) < 0.5 * np.median(noise[untouched])
    assert composite.coverage.max() == 1.0
    assert not background.coverage.any()

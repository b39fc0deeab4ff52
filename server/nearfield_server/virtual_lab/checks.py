"""Checks the gather estimator against Mitsuba's own path tracer, an independent implementation of light transport."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.virtual_lab.backend import Backend
from nearfield_server.virtual_lab.geometry import Cells, Geometry, build_cells, build_geometry
from nearfield_server.virtual_lab.model import Scene
from nearfield_server.virtual_lab.radiosity import solve_radiosity
from nearfield_server.virtual_lab.render import shade_rays
from nearfield_server.virtual_lab.sampling import Sampler
from nearfield_server.virtual_lab.tracer import Tracer

# Rays for the comparison start this far above the point they look at, metres.
EYE_DISTANCE = 5e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class PathComparison:
    """Reflected radiance of random surface points under the nominal mix of lights.

    Attributes:
        is_object: (N,) bool, whether the point lies on a virtual object.
        estimate, truth: (N, 3) float64, gather estimator and path tracer.
        estimate_error, truth_error: (N, 3) float64 standard errors of the means.
    """

    is_object: NDArray[np.bool_]
    estimate: NDArray[np.float64]
    truth: NDArray[np.float64]
    estimate_error: NDArray[np.float64]
    truth_error: NDArray[np.float64]

    def summary(self, selected: NDArray[np.bool_]) -> dict[str, float]:
        """Ratio of means, its standard error, and RMS and largest z score over the selected points."""
        estimate, truth = self.estimate[selected], self.truth[selected]
        variance = self.estimate_error[selected] ** 2 + self.truth_error[selected] ** 2
        z_score = (estimate - truth) / np.sqrt(np.maximum(variance, 1e-20))
        error = np.sqrt(variance.reshape(-1, 3).sum(axis=0)).sum() / truth.sum()
        return {
            "points": int(selected.sum()),
            "ratio": float(estimate.sum() / truth.sum()),
            "ratio_error": float(error),
            "rms_z": float(np.sqrt(np.mean(z_score**2))),
            "max_z": float(np.abs(z_score).max()),
        }


def path_scene(backend: Backend, scene: Scene, geometry: Geometry) -> Any:
    """The same scene for Mitsuba's integrators: one mesh per material, area emitters of nominal radiance."""
    mi = backend.mi
    keys = np.where(geometry.face_light >= 0, geometry.face_light, -1)
    groups = np.unique(
        np.column_stack([geometry.face_albedo, keys, geometry.face_object]), axis=0, return_inverse=True
    )[1].ravel()
    content: dict[str, Any] = {"type": "scene"}
    for group in range(int(groups.max()) + 1):
        faces = np.flatnonzero(groups == group)
        albedo, light, owner = (
            geometry.face_albedo[faces[0]],
            int(keys[faces[0]]),
            int(geometry.face_object[faces[0]]),
        )
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(
            {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo.tolist()}}
        )
        if light >= 0:
            radiance = {"type": "rgb", "value": list(scene.lights[light].radiance)}
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
        used, local = np.unique(geometry.faces[faces], return_inverse=True)
        mesh = mi.Mesh(
            f"group{group}", len(used), len(faces), props=properties, has_vertex_normals=owner >= 0
        )
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = mi.Float(geometry.positions[used].astype(np.float32).ravel())
        if owner >= 0:
            parameters["vertex_normals"] = mi.Float(geometry.normals[used].astype(np.float32).ravel())
        parameters["faces"] = mi.UInt32(local.astype(np.uint32).ravel())
        parameters.update()
        content[f"group{group}"] = mesh
    return mi.load_dict(content)


def random_points(
    cells: Cells, count: int, *, on_objects: bool, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and geometric normals (N, 3), uniform over the area of the room or of the objects; emitters are left out."""
    weight = np.where((cells.is_triangle == on_objects) & (cells.light < 0), cells.area, 0.0)
    chosen = rng.choice(len(weight), size=count, p=weight / weight.sum())
    u, v = rng.random((2, count, 1))
    if on_objects:
        folded = u + v > 1
        u, v = np.where(folded, 1 - u, u), np.where(folded, 1 - v, v)
    return cells.origin[chosen] + u * cells.edge_u[chosen] + v * cells.edge_v[chosen], cells.normal[chosen]


def compare_with_path(
    backend: Backend,
    scene: Scene,
    *,
    room_points: int,
    object_points: int,
    replicas: int,
    samples: int,
    cell_points: int,
    seed: int = 1,
) -> PathComparison:
    """Estimate the radiance of random points with both methods; the virtual objects are present.

    Args:
        backend: Mitsuba.
        scene: to check.
        room_points: points on real surfaces (covered ones, inside of standing boxes, are dropped).
        object_points: points on virtual objects.
        replicas: independent means per point, at least 8 for a usable standard error.
        samples: path-traced samples per replica (the gather estimator takes a quarter with 4 rays each).
        cell_points: sample points per radiosity cell.
        seed: of points and paths.
    """
    mi, dr = backend.mi, backend.dr
    rng = np.random.default_rng(seed)
    geometry = build_geometry(scene, with_objects=True)
    cells, tracer = build_cells(scene, geometry), Tracer(backend, scene, geometry)
    cache = solve_radiosity(tracer, cells, points=cell_points, rays_per_point=4, seed=seed)
    tracer.set_cache(cache.reflected_radiance)
    picked = [
        random_points(cells, n, on_objects=flag, rng=rng)
        for n, flag in ((room_points, False), (object_points, True))
    ]
    position, normal = (np.concatenate([pair[part] for pair in picked]) for part in range(2))
    lanes = np.repeat(np.arange(len(position)), replicas)
    origin = mi.Point3f(np.ascontiguousarray((position + EYE_DISTANCE * normal)[lanes].T.astype(np.float32)))
    direction = mi.Vector3f(np.ascontiguousarray(-normal[lanes].T.astype(np.float32)))
    sampler = Sampler(backend, dr.arange(mi.UInt32, len(lanes)), seed)
    sums = [mi.Float(0.0)] * (6 * tracer.num_lights + 2)
    steps = max(samples // 4, 1)
    for sample in range(steps):
        values = shade_rays(tracer, origin, direction, sampler, dr.opaque(mi.UInt32, sample), 4)
        sums = [a + b for a, b in zip(sums, values, strict=True)]
        dr.eval(sums)
    basis = (
        np.stack([s.numpy() for s in sums[:-2]]).reshape(2, tracer.num_lights, 3, len(lanes)).sum(axis=0)
        / steps
    )
    radiance = np.array([light.radiance for light in scene.lights])
    estimate = np.einsum("kcn,kc->nc", basis, radiance)
    truth = _path_radiance(
        backend, path_scene(backend, scene, geometry), origin, direction, len(lanes), samples, seed
    )
    shape = (len(position), replicas, 3)
    estimate, truth = estimate.reshape(shape), truth.reshape(shape)
    seen = truth.mean(axis=(1, 2)) > 0
    share = np.sqrt(replicas)
    return PathComparison(
        is_object=(np.arange(len(position)) >= room_points)[seen],
        estimate=estimate.mean(axis=1)[seen],
        truth=truth.mean(axis=1)[seen],
        estimate_error=(estimate.std(axis=1, ddof=1) / share)[seen],
        truth_error=(truth.std(axis=1, ddof=1) / share)[seen],
    )


def _path_radiance(
    backend: Backend, scene: Any, origin: Any, direction: Any, lanes: int, samples: int, seed: int
) -> NDArray[np.float64]:
    """(lanes, 3) radiance along rays by Mitsuba's `path` integrator."""
    mi, dr = backend.mi, backend.dr
    integrator = mi.load_dict({"type": "path", "max_depth": 64, "rr_depth": 12})
    sampler = mi.load_dict({"type": "independent", "sample_count": samples})
    total = mi.Color3f(0.0)
    for sample in range(samples):
        sampler.seed(seed * 100003 + sample, lanes)
        ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
        total += integrator.sample(scene, sampler, ray)[0]
        dr.eval(total)
    return np.asarray(total.numpy().T / samples, dtype=np.float64)

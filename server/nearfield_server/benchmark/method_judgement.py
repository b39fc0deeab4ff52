"""Judgement of a method's light by the truth of a bundle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.benchmark.method_scene import MethodScene
from nearfield_server.benchmark.methods.light import MethodLight
from nearfield_server.evaluation.evaluate import load_points
from nearfield_server.evaluation.irradiance import PlacedObject, estimate_irradiance, make_caster


def irradiance_at_points(
    scene: MethodScene, light: MethodLight, objects: tuple[PlacedObject, ...], *, room_shadows: bool = True
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Irradiance at the bundle's points under some light, and the true one: (P, 3) W/m^2 each; None without points, or in the dark.

    Args:
        scene: the bundle.
        light: of a method.
        objects: with the transfer that the method knows.
        room_shadows: whether the method knows that the room hides its lights.

    Raises:
        AssetError: points.npz is broken or belongs to other objects.
    """
    bundle, mesh = scene.bundle, scene.mesh
    if bundle.points is None or not objects:
        return None
    points, normals, index, truth = load_points(bundle.points, bundle, bundle.weights())
    if not truth.mean() > 0.0:
        return None
    blockers = mesh.faces if room_shadows else np.zeros((0, 3), mesh.faces.dtype)
    estimate = estimate_irradiance(
        points,
        normals,
        index,
        vals=light.vals,
        object_sh=light.object_sh,
        objects=objects,
        caster=make_caster(mesh.positions, blockers, objects),
        room_caster=make_caster(mesh.positions, mesh.faces, ()),
        room_albedo=mesh.material_albedo[mesh.face_material],
    ).total
    return estimate, truth


def mean_of_views(judged: Sequence[dict[str, Any]], key: str) -> float | None:
    """Mean over the views that define the figure; None where none does."""
    values = [view[key] for view in judged if view[key] is not None]
    return float(np.mean(values)) if values else None

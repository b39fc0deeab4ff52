"""Evaluates one bundle under one lighting: light, irradiance, atlas, views."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.evaluation import irradiance
from nearfield_server.evaluation.atlas_metrics import judge_atlas, load_cells
from nearfield_server.evaluation.irradiance import PlacedObject, estimate_irradiance, make_caster
from nearfield_server.evaluation.light_run import LightRun, camera_frames, run_light
from nearfield_server.evaluation.page_server import render_views
from nearfield_server.evaluation.report_page import ViewPictures, write_report
from nearfield_server.evaluation.view_truth import bundle_exposure, emitter_faces, judge_view, load_view_truth
from nearfield_server.geometry.cache import load_or_build
from nearfield_server.radiometry.image_metrics import average_2x2
from nearfield_server.records import RoomMesh
from nearfield_server.scene.bundle import Bundle, load_bundle
from nearfield_server.scene.prepared_cache import ensure_prepared
from nearfield_server.scene.prepared_model import load_prepared
from nearfield_server.scene.room_config import RoomConfig, room_from_bundle

Progress = Callable[[str], None]
_PACKAGES = (
    "nearfield",
    "numpy",
    "numba",
    "embreex",
    "OpenEXR",
    "playwright",
    "flip-evaluator",
    "scikit-image",
)


def evaluate_bundle(
    path: str | Path,
    out: str | Path,
    *,
    num_vals: int = 16,
    split_ratio: float | None = None,
    lighting: str = "nominal",
    preset: str = "medium",
    with_views: bool = True,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run everything and write the report.

    Args:
        path: bundle folder or its scene.json.
        out: folder for report.json, index.html and pictures.
        num_vals: slots for virtual area lights, 1 to 64.
        split_ratio: see `LightSettings`; None chooses.
        lighting: "nominal" or SEQUENCE:FRAME.
        preset: quality of prepared models.
        with_views: render the tablet views with the real client.
        progress: called with a line of text before each step.

    Returns:
        The content of report.json.

    Raises:
        ConfigError: a setting is out of range or the lighting does not exist.
        AssetError: a file is missing or broken.
        ServiceError: the client is not built, or the browser cannot be started.
    """
    check_settings(num_vals, split_ratio)
    say = progress if progress is not None else _silent
    say("reading the bundle")
    bundle = load_bundle(path)
    weights = bundle.weights(lighting)
    room = _room_under(room_from_bundle(bundle), weights, num_vals, split_ratio)
    say("geometry of the room")
    mesh, texels, table, fill, hidden = load_or_build(room)
    say("virtual objects")
    objects = place_objects(bundle, preset)
    say("camera pictures")
    frames, clean_counts = camera_frames(bundle, weights)
    say("light")
    run = run_light(mesh, texels, table, fill, hidden, frames, objects, room.light, clean_counts)
    say("irradiance and atlas")
    cells = load_cells(bundle.cells, bundle, weights) if bundle.cells is not None else None
    atlas = None if cells is None else judge_atlas(texels, table, run.texel_radiance, cells)
    report: dict[str, Any] = {
        "irradiance": judge_irradiance(bundle, weights, mesh, objects, run),
        "views": [],
        "atlas": None
        if atlas is None
        else {"total_energy_error": atlas.total_energy_error, "spurious_energy": atlas.spurious_energy},
        "packet_bytes": len(run.packet_bytes),
        "stage_ms": run.stage_ms,
        "settings": _settings(bundle, run, num_vals, split_ratio, lighting, preset),
    }
    exposure = bundle_exposure(bundle)
    report["settings"]["exposure"] = exposure
    pictures: list[ViewPictures] = []
    views = [v for v in bundle.views if v.small_with_object or v.with_object] if with_views else []
    if views:
        wanted = [bundle.views.index(view) for view in views]
        rendered = render_views(room, mesh, texels, run, wanted, preset=preset, progress=say)
        report["settings"]["browser"] = rendered.browser
        emitter = emitter_faces(bundle, mesh)
        for view, composite in zip(views, rendered.composites, strict=True):
            say(f"judging view {view.model.view_id}")
            truth = load_view_truth(bundle, view, weights, mesh, emitter)
            half = average_2x2(composite[..., :3])
            report["views"].append(judge_view(truth, half, exposure))
            pictures.append(
                ViewPictures(
                    view_id=truth.view_id, composite=half, truth=truth.truth, background=truth.background
                )
            )
    say("writing the report")
    write_report(Path(out), report, pictures, exposure)
    return report


def check_settings(num_vals: int, split_ratio: float | None) -> None:
    """Refuse settings out of range.

    Raises:
        ConfigError: names the option and its range.
    """
    if not 1 <= num_vals <= 64:
        raise ConfigError(f"--vals {num_vals}: expected 1 to 64.")
    if split_ratio is not None and not 0.0 < split_ratio <= 1.0:
        raise ConfigError(f"--ratio {split_ratio:g}: expected more than 0, at most 1.")


def place_objects(bundle: Bundle, preset: str) -> tuple[PlacedObject, ...]:
    """Prepared forms of all virtual objects of a bundle, from the cache where it holds them."""
    return tuple(
        PlacedObject(
            model=load_prepared(ensure_prepared(item.model_path, preset)),
            albedo=np.asarray(item.albedo, np.float64),
            world_from_object=item.world_from_object,
        )
        for item in bundle.objects
    )


def judge_irradiance(
    bundle: Bundle,
    weights: NDArray[np.float64],
    mesh: RoomMesh,
    objects: tuple[PlacedObject, ...],
    run: LightRun,
) -> dict[str, float] | None:
    """Errors at the bundle's points of what a client computes from the packet; None where the bundle has no points, or they are dark.

    Raises:
        AssetError: points.npz is broken or belongs to other objects.
    """
    if bundle.points is None or not objects:
        return None
    points, normals, index, truth = load_points(bundle.points, bundle, weights)
    if not truth.mean() > 0.0:
        return None
    estimate = estimate_irradiance(
        points,
        normals,
        index,
        vals=run.packet.vals,
        object_sh=run.packet.object_sh,
        objects=objects,
        caster=make_caster(mesh.positions, mesh.faces, objects),
        room_caster=make_caster(mesh.positions, mesh.faces, ()),
        room_albedo=mesh.material_albedo[mesh.face_material],
    ).total
    return {
        "rel_rmse": irradiance.rel_rmse(estimate, truth),
        "bias": irradiance.bias(estimate, truth),
        "median_rel": irradiance.median_rel(estimate, truth),
    }


def load_points(
    path: Path, bundle: Bundle, weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Positions (P, 3), normals (P, 3), object index in the bundle (P,) and true irradiance with the objects in place (P, 3).

    Raises:
        AssetError: arrays are missing, do not fit the lights, or name unknown objects.
    """
    try:
        with np.load(path) as data:
            position, normal, index = data["position"], data["normal"], data["object"].astype(np.int64)
            names = [str(name) for name in data["object_names"]]
            direct, indirect = data["with_direct"], data["with_indirect"]
    except (OSError, KeyError, ValueError) as error:
        raise AssetError(
            f"{path}: cannot be read as irradiance points ({error}). Copy the bundle again."
        ) from error
    if direct.shape != (len(position), len(bundle.lights)):
        raise AssetError(
            f"{path}:with_direct: expected {(len(position), len(bundle.lights))}, found {direct.shape}."
        )
    known = [item.name for item in bundle.objects]
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise AssetError(f"{path}:object_names: expected names among {known}, found {unknown}.")
    order = np.array([known.index(name) for name in names], np.int64)
    # The points hold irradiance per unit radiance, unlike the pictures, which are made at basis_radiance.
    radiance = np.array([light.radiance for light in bundle.lights]) * weights[:, None]
    truth = np.einsum("pk,kc->pc", direct, radiance) + np.einsum("pkc,kc->pc", indirect, radiance)
    return position.astype(np.float64), normal.astype(np.float64), order[index], truth


def _room_under(
    room: RoomConfig, weights: NDArray[np.float64], num_vals: int, split_ratio: float | None
) -> RoomConfig:
    """The room with the evaluated settings, its lamps at the evaluated weights (the client mixes its backgrounds by them)."""
    lights = tuple(
        replace(light, weight=float(weight)) for light, weight in zip(room.lights, weights, strict=True)
    )
    return replace(room, lights=lights, light=replace(room.light, num_vals=num_vals, split_ratio=split_ratio))


def _settings(
    bundle: Bundle, run: LightRun, num_vals: int, split_ratio: float | None, lighting: str, preset: str
) -> dict[str, Any]:
    return {
        "bundle": bundle.name,
        "lighting": lighting,
        "vals": num_vals,
        "vals_used": int(np.count_nonzero(run.packet.vals["radiant_intensity"].any(axis=1))),
        "ratio": split_ratio,
        "threshold": [float(value) if np.isfinite(value) else None for value in run.update.threshold],
        "preset": preset,
        "backend": run.backend,
        "corrected_pixels": run.clean_counts,
        "counters": {name: float(value) for name, value in run.update.counters.items()},
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in _PACKAGES},
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _silent(text: str) -> None:
    """Report nothing."""

"""Truth of a tablet view, mixed for one lighting, and the judgement of a composite by it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.models import PinholeIntrinsics
from nearfield_server.errors import AssetError
from nearfield_server.radiometry import image_metrics
from nearfield_server.records import RoomMesh, TabletView
from nearfield_server.scene.bundle import Bundle, BundleView, mix_basis
from nearfield_server.scene.exr import read_exr
from nearfield_server.scene.gltf import read_glb_chunks
from nearfield_server.scene.ray_caster import RayCaster

# Rays per side of a pixel of the full-size picture when looking for emitters.
_EMITTER_RAYS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewTruth:
    """What a view should show, at half size.

    Attributes:
        view_id: from the bundle.
        truth: (H, W, 3) with the virtual objects. background: (H, W, 3) without.
        composite_background: (H, W, 3) the full-size background, averaged 2x2: what a client draws on (its compression differs
        from `background`).
        coverage: (H, W) of the virtual objects in [0, 1].
        sees_emitter: (H, W) pixels that show some of a light source.
    """

    view_id: str
    truth: NDArray[np.float64]
    background: NDArray[np.float64]
    composite_background: NDArray[np.float64]
    coverage: NDArray[np.float64]
    sees_emitter: NDArray[np.bool_]


def load_view_truth(
    bundle: Bundle, view: BundleView, weights: NDArray[np.float64], mesh: RoomMesh, emitter: NDArray[np.bool_]
) -> ViewTruth:
    """Mix the truth of one view. Half-size files are used where the bundle has them, else the full-size ones averaged 2x2.

    Args:
        bundle: where the view is from.
        view: the view.
        weights: (lights,) light weights.
        mesh: room, to find the pixels that see a light source.
        emitter: (F,) faces of the room that shine.

    Raises:
        AssetError: the view has no pictures with the objects, or sizes do not match.
    """
    factors = bundle.light_factors(weights)
    lens = view.model.intrinsics
    size = (lens.height // 2, lens.width // 2)
    full_background = image_metrics.average_2x2(_mixed(view.background, factors, (lens.height, lens.width)))
    if view.small_with_object and view.small_background:
        truth, background = (
            _mixed(view.small_with_object, factors, size),
            _mixed(view.small_background, factors, size),
        )
    elif view.with_object:
        truth = image_metrics.average_2x2(_mixed(view.with_object, factors, (lens.height, lens.width)))
        background = full_background
    else:
        raise AssetError(
            f"view {view.model.view_id}: expected pictures with the virtual objects, found none."
        )
    return ViewTruth(
        view_id=view.model.view_id,
        truth=truth,
        background=background,
        composite_background=full_background,
        coverage=_coverage(view, (lens.height, lens.width)),
        sees_emitter=emitter_pixels(view.model, mesh, emitter),
    )


def judge_view(truth: ViewTruth, composite: NDArray[np.floating], exposure: float) -> dict[str, Any]:
    """All errors of one composite.

    Args:
        truth: of the view.
        composite: (H, W, 3) linear, averaged 2x2.
        exposure: display exposure of the bundle.
    """
    shown, expected = image_metrics.display(composite, exposure), image_metrics.display(truth.truth, exposure)
    return {
        "id": truth.view_id,
        "object_rel_rmse": image_metrics.object_rel_rmse(composite, truth.truth, truth.coverage),
        "shadow_rel_rmse": image_metrics.shadow_rel_rmse(
            composite - truth.composite_background,
            truth.truth - truth.background,
            truth.coverage,
            truth.sees_emitter,
        ),
        "flip_mean": image_metrics.flip_mean(expected, shown),
        "ssim": image_metrics.ssim(expected, shown),
    }


def bundle_exposure(bundle: Bundle) -> float:
    """The one display exposure of a bundle: from the backgrounds of all its views under nominal lighting."""
    factors = bundle.light_factors(bundle.weights())
    pictures = []
    for view in bundle.views:
        lens = view.model.intrinsics
        files, size = (
            (view.small_background, (lens.height // 2, lens.width // 2))
            if view.small_background
            else (view.background, (lens.height, lens.width))
        )
        pictures.append(_mixed(files, factors, size))
    return image_metrics.common_exposure(pictures)


def emitter_faces(bundle: Bundle, mesh: RoomMesh) -> NDArray[np.bool_]:
    """Faces of the room whose material is marked emissive in the GLB: (F,). Read for judging only, never for lighting."""
    document, _ = read_glb_chunks(bundle.model_path)
    shining = {
        str(material.get("name", f"material{index}"))
        for index, material in enumerate(document.get("materials", []))
        if any(float(value) > 0.0 for value in material.get("emissiveFactor", ()))
    }
    is_emitter = np.array([name in shining for name in mesh.materials], np.bool_)
    return is_emitter[mesh.face_material]


def emitter_pixels(view: TabletView, mesh: RoomMesh, emitter: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Half-size pixels in which some ray of a regular grid meets an emitting face first: (H / 2, W / 2)."""
    lens = view.intrinsics
    if not emitter.any():
        return np.zeros((lens.height // 2, lens.width // 2), np.bool_)
    caster = RayCaster(mesh.positions, mesh.faces)
    steps = (np.arange(_EMITTER_RAYS) + 0.5) / _EMITTER_RAYS - 0.5
    found = np.zeros((lens.height, lens.width), np.bool_)
    for dy in steps:
        for dx in steps:
            directions = pinhole_directions(lens, dx, dy) @ view.world_from_camera[:3, :3].T
            origins = np.broadcast_to(view.world_from_camera[:3, 3], directions.shape)
            face = caster.closest(origins, directions).face
            found |= ((face >= 0) & emitter[face]).reshape(lens.height, lens.width)
    return np.asarray(found.reshape(lens.height // 2, 2, lens.width // 2, 2).any(axis=(1, 3)))


def pinhole_directions(lens: PinholeIntrinsics, dx: float = 0.0, dy: float = 0.0) -> NDArray[np.float64]:
    """Unit directions through all pixels, shifted by (dx, dy) pixels, camera axes, row by row: (H W, 3)."""
    columns, rows = np.meshgrid(np.arange(lens.width) + dx, np.arange(lens.height) + dy)
    rays = np.stack(
        [(columns - lens.cx) / lens.fx, (rows - lens.cy) / lens.fy, np.ones_like(columns)], axis=-1
    )
    rays = rays.reshape(-1, 3)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _mixed(files: Sequence[Path], factors: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.float64]:
    pictures = [read_exr(path) for path in files]
    for path, picture in zip(files, pictures, strict=True):
        if picture.shape[:2] != size:
            raise AssetError(
                f"{path}: expected {size[1]} x {size[0]} pixels, found {picture.shape[1]} x {picture.shape[0]}."
            )
    return mix_basis(pictures, factors)


def _coverage(view: BundleView, size: tuple[int, int]) -> NDArray[np.float64]:
    """Mask in [0, 1] at half size; a view without mask shows no virtual object."""
    if view.mask is None:
        return np.zeros((size[0] // 2, size[1] // 2))
    mask = cv2.imread(str(view.mask), cv2.IMREAD_GRAYSCALE)
    if mask is None:
        raise AssetError(f"{view.mask}: is not a picture that can be read. Copy the bundle again.")
    if mask.shape == (size[0] // 2, size[1] // 2):
        return np.asarray(mask / 255.0)
    if mask.shape != size:
        raise AssetError(
            f"{view.mask}: expected {size[1]} x {size[0]} pixels, found {mask.shape[1]} x {mask.shape[0]}."
        )
    return image_metrics.average_2x2(mask.astype(np.float64) / 255.0)

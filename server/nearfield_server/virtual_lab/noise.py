"""Monte Carlo noise from two independent halves, in the layout of noise.json."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.virtual_lab.pictures import box_half
from nearfield_server.virtual_lab.render import PointIrradiance, RenderedImage


def halves_noise(halves: NDArray[Any], selected: NDArray[np.bool_] | None = None) -> dict[str, float]:
    """Noise of the mean of two halves: `noise_rms` = RMS(a - b) / 2, `mean`, and their ratio `rel`.

    Args:
        halves: (2, H, W, 3).
        selected: (H, W) pixels to use, or None for all.
    """
    first, second = (halves[part] if selected is None else halves[part][selected] for part in range(2))
    if first.size == 0:
        return {"noise_rms": 0.0, "mean": 0.0, "rel": 0.0}
    noise = float(np.sqrt(np.mean((first - second) ** 2, dtype=np.float64))) / 2
    mean = float(np.mean((first + second) / 2, dtype=np.float64))
    return {"noise_rms": noise, "mean": mean, "rel": noise / mean if mean > 0 else 0.0}


def view_noise(
    background: RenderedImage,
    composite: RenderedImage,
    radiance: NDArray[np.float64],
    basis: NDArray[np.float64],
) -> dict[str, Any]:
    """Noise of one view per light (at basis radiance) and of the nominal mix.

    Args:
        background: without the virtual objects.
        composite: with them.
        radiance: (K, 3) nominal radiance.
        basis: (K,) basis radiance.
    """
    emits = background.emission > 0
    scene, objects = ~emits & (composite.coverage < 0.001), composite.coverage > 0.999
    weights = {
        f"light{k}": np.where(np.arange(len(basis)) == k, basis, 0.0)[:, None] * np.ones(3)
        for k in range(len(basis))
    }
    weights["nominal"] = radiance
    result = {}
    for name, weight in weights.items():
        used = np.flatnonzero(weight.any(axis=1))
        bg, full = (
            sum(image.total_halves[:, k] * weight[k].astype(np.float32) for k in used)
            for image in (background, composite)
        )
        result[name] = _view_entry(np.asarray(bg), np.asarray(full), scene, objects)
    return result


def _view_entry(
    background: NDArray[np.float32],
    composite: NDArray[np.float32],
    scene: NDArray[np.bool_],
    objects: NDArray[np.bool_],
) -> dict[str, Any]:
    small_scene, small_objects = (
        box_half(np.repeat(mask[..., None], 3, axis=-1).astype(np.float32))[..., 0] == 1
        for mask in (scene, objects)
    )
    entry: dict[str, Any] = {}
    for suffix, bg, full, where, inside in (
        ("", background, composite, scene, objects),
        ("_small", box_half(background), box_half(composite), small_scene, small_objects),
    ):
        entry[f"bg_scene{suffix}"] = halves_noise(bg, where)
        entry[f"with_scene{suffix}"] = halves_noise(full, where)
        entry[f"with_obj{suffix}"] = halves_noise(full, inside)
        difference = full - bg
        entry[f"shadow_diff{suffix}"] = {
            "noise_rms": halves_noise(difference, where)["noise_rms"],
            "signal_rms": float(np.sqrt(np.mean(difference.mean(axis=0)[where] ** 2, dtype=np.float64))),
        }
    return entry


def camera_noise(
    image: RenderedImage, basis: NDArray[np.float64], inside: NDArray[np.bool_]
) -> dict[str, Any]:
    """Noise of a fish-eye per light over pixels of the image circle that show no emitter; adds the median of |a - b| / 2 / value."""
    where = inside & (image.emission == 0)
    result = {}
    for k, radiance in enumerate(basis):
        halves = image.total_halves[:, k] * np.float32(radiance)
        first, second = halves[0][where].mean(axis=-1), halves[1][where].mean(axis=-1)
        lit = first + second > 0
        relative = np.abs(first - second)[lit] / (first + second)[lit]
        result[f"light{k}"] = halves_noise(halves, where) | {
            "median_abs_rel": float(np.median(relative)) if relative.size else 0.0
        }
    return result


def point_noise(points: PointIrradiance) -> dict[str, list[float]]:
    """RMS noise of direct and indirect point irradiance of each light over the mean total of that light."""
    total = (points.direct[..., None] + points.indirect).mean(axis=(0, 1, 3))
    direct = np.sqrt(np.mean((points.direct[0] - points.direct[1]) ** 2, axis=0)) / 2
    indirect = np.sqrt(np.mean((points.indirect[0] - points.indirect[1]) ** 2, axis=(0, 2))) / 2
    return {
        "direct_noise_rel_to_mean_total": (direct / total).tolist(),
        "indirect_noise_rel_to_mean_total": (indirect / total).tolist(),
    }

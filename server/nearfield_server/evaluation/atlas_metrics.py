"""Judges the gathered radiance atlas by the bundle's perfect one (`cells.npz`).

Only texels that some camera sees take part. Each takes the radiance of the nearest cell of its own plane: emission for cells
of a light, reflected radiance for
all others. Texels whose cell is marked invalid (inside furniture) are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nearfield_server.errors import AssetError
from nearfield_server.records import GatherTable, TexelGeometry
from nearfield_server.scene.bundle import Bundle

# Cells are 2.5 to 4 cm wide; these factors make another plane farther than any cell of the texel's own: 1 cm off the plane counts as 20 cm,
# a normal turned by 30 degrees as half a metre.
_PLANE_WEIGHT = 20.0
_NORMAL_WEIGHT = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """Perfect radiance under one lighting.

    Attributes:
        centre: (C, 3) world. normal: (C, 3). radiance: (C, 3). light: (C,) index or -1. valid: (C,).
    """

    centre: NDArray[np.float64]
    normal: NDArray[np.float64]
    radiance: NDArray[np.float64]
    light: NDArray[np.int64]
    valid: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class AtlasMetrics:
    """Errors relative to the true energy sum L A over the texels that take part.

    Attributes:
        total_energy_error: |sum L A - truth| / truth.
        spurious_energy: what all surfaces that are no emitters hold together above their truth, over the truth; 0 where they hold
            less. Noise cancels, light that spills from lamps onto their surroundings does not.
        num_texels: texels that took part.
    """

    total_energy_error: float
    spurious_energy: float
    num_texels: int


def load_cells(path: Path, bundle: Bundle, weights: NDArray[np.float64]) -> Cells:
    """Read `cells.npz` and mix it for the given light weights.

    Raises:
        AssetError: arrays are missing or do not fit the lights of the bundle.
    """
    try:
        with np.load(path) as data:
            centre, normal, light = data["centre"], data["normal"], data["light"].astype(np.int64)
            reflected = data["reflected_radiance"].astype(np.float64)
            valid = data["valid"] if "valid" in data else np.ones(len(centre), np.bool_)
    except (OSError, KeyError, ValueError) as error:
        raise AssetError(
            f"{path}: cannot be read as radiance cells ({error}). Copy the bundle again."
        ) from error
    if reflected.shape != (len(centre), len(bundle.lights), 3):
        raise AssetError(
            f"{path}:reflected_radiance: expected {(len(centre), len(bundle.lights), 3)}, found {reflected.shape}."
        )
    radiance = np.einsum("nkc,kc->nc", np.nan_to_num(reflected), bundle.light_factors(weights))
    emitted = np.array([item.radiance for item in bundle.lights]) * weights[:, None]
    lamps = light >= 0
    radiance[lamps] = emitted[light[lamps]]
    return Cells(
        centre=centre.astype(np.float64),
        normal=normal.astype(np.float64),
        radiance=radiance,
        light=light,
        valid=valid.astype(np.bool_) | lamps,
    )


def judge_atlas(
    texels: TexelGeometry, table: GatherTable, texel_radiance: NDArray[np.floating], cells: Cells
) -> AtlasMetrics:
    """Compare the gathered atlas with the truth.

    Args:
        texels: the atlas.
        table: which texels some camera sees.
        texel_radiance: (N, 3) in texel order.
        cells: the truth.
    """
    seen = np.flatnonzero(np.diff(table.pair_start) > 0)
    cell = nearest_cells(texels.position[seen], texels.normal[seen], cells)
    seen, cell = seen[cells.valid[cell]], cell[cells.valid[cell]]
    area = texels.area[seen].astype(np.float64)[:, None]
    found = np.zeros_like(cells.radiance)
    np.add.at(found, cell, texel_radiance[seen].astype(np.float64) * area)
    true = np.zeros_like(found)
    np.add.at(true, cell, cells.radiance[cell] * area)
    truth = float(true.sum())
    if truth <= 0.0:
        dark = float(found.sum())
        return AtlasMetrics(total_energy_error=dark, spurious_energy=dark, num_texels=len(seen))
    excess = (found - true)[cells.light < 0]
    return AtlasMetrics(
        total_energy_error=abs(float(found.sum()) - truth) / truth,
        spurious_energy=max(0.0, float(excess.sum())) / truth,
        num_texels=len(seen),
    )


def nearest_cells(
    positions: NDArray[np.floating], normals: NDArray[np.floating], cells: Cells
) -> NDArray[np.int64]:
    """Nearest cell of the same plane for each point: (n,)."""

    def keys(p: NDArray[np.floating], n: NDArray[np.floating]) -> NDArray[np.float64]:
        p, n = np.asarray(p, np.float64), np.asarray(n, np.float64)
        plane = np.einsum("ij,ij->i", p, n)[:, None]
        return np.hstack([p, _NORMAL_WEIGHT * n, _PLANE_WEIGHT * plane])

    _, index = cKDTree(keys(cells.centre, cells.normal)).query(keys(positions, normals))
    return np.asarray(index, np.int64)

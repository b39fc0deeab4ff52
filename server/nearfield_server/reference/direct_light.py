"""Irradiance from the atlas itself, without clusters: the truth that clusters are judged by, and the older baseline."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nearfield_server.records import TexelGeometry


def direct_sum_irradiance(
    texels: TexelGeometry,
    radiance: NDArray[np.floating],
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Unoccluded irradiance summed over all texels (Rohmer et al. 2014, Eq. 5 without albedo and visibility).

    Each texel is a small disc (`dA / pi` added to the squared distance), which bounds the error next to a surface.

    Args:
        texels: N texels.
        radiance: (N, 3); pass the direct or the indirect part to get its share.
        points: (P, 3) metres.
        normals: (P, 3) unit.

    Returns:
        (P, 3) W/m^2, float64.
    """
    shining = np.flatnonzero(np.asarray(radiance).any(axis=1))
    position = texels.position[shining].astype(np.float64)
    normal = texels.normal[shining].astype(np.float64)
    area = texels.area[shining].astype(np.float64)
    intensity = np.asarray(radiance, dtype=np.float64)[shining] * area[:, None]
    return _sum_of_discs(position, normal, area, intensity, points, normals)


def vpl_irradiance(
    texels: TexelGeometry,
    radiance: NDArray[np.floating],
    chosen: NDArray[np.integer],
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Baseline: unclustered virtual point lights, `I = (1 / N) I_s / p_s` (Rohmer et al. 2014, Eq. 14).

    The density p_s is proportional to the grey radiant intensity of the texel. As printed, a point light is singular.

    Args:
        texels: N texels.
        radiance: (N, 3), of which `chosen` are samples with that density.
        chosen: (S,) positions in texel order.
        points: (P, 3) metres.
        normals: (P, 3) unit.

    Returns:
        (P, 3) W/m^2, float64.
    """
    intensity = np.asarray(radiance, dtype=np.float64) * texels.area.astype(np.float64)[:, None]
    grey = intensity.mean(axis=1)
    density = grey[chosen] / grey.sum()
    light = intensity[chosen] / density[:, None] / chosen.shape[0]
    position = texels.position[chosen].astype(np.float64)
    normal = texels.normal[chosen].astype(np.float64)
    return _sum_of_discs(position, normal, np.zeros(chosen.shape[0]), light, points, normals)


def _sum_of_discs(
    position: NDArray[np.float64],
    normal: NDArray[np.float64],
    area: NDArray[np.float64],
    intensity: NDArray[np.float64],
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
) -> NDArray[np.float64]:
    result = np.zeros((len(points), 3))
    for k, (point, facing) in enumerate(zip(points, normals, strict=True)):
        offset = position - np.asarray(point, dtype=np.float64)
        squared = np.einsum("ni,ni->n", offset, offset)
        cosines = np.maximum(offset @ facing, 0.0) * np.maximum(-np.einsum("ni,ni->n", offset, normal), 0.0)
        denominator = squared * (squared + area / np.pi)
        geometry = np.divide(cosines, denominator, out=np.zeros_like(cosines), where=denominator > 0.0)
        result[k] = geometry @ intensity
    return result

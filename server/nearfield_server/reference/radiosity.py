"""Light in equilibrium in a closed convex room, in float64: gives tests pictures whose indirect light is consistent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nearfield_server.records import TexelGeometry

_BOUNCES = 25


def transport_matrix(texels: TexelGeometry) -> NDArray[np.float64]:
    """(N, N) irradiance on texel i per unit radiance of texel j, where all texels see each other.

    Texels count as discs; rows are scaled to sum to pi, as they must in a closed room.
    """
    position, normal = texels.position.astype(np.float64), texels.normal.astype(np.float64)
    offset = position[None] - position[:, None]
    squared = np.maximum((offset**2).sum(axis=2), 1e-12)
    cosines = np.maximum(np.einsum("ijk,ik->ij", offset, normal), 0.0)
    cosines *= np.maximum(-np.einsum("ijk,jk->ij", offset, normal), 0.0)
    area = texels.area.astype(np.float64)
    matrix = cosines * area / (squared * (squared + area / np.pi))
    return np.asarray(matrix * (np.pi / matrix.sum(axis=1, keepdims=True)))


def equilibrium_radiance(
    transport: NDArray[np.float64], emitted: NDArray[np.float64], albedo: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(N, 3) radiance of diffuse texels after many bounces.

    Args:
        transport: from `transport_matrix`.
        emitted: (N, 3) radiance of lamps.
        albedo: (N, 1) or (N, 3).
    """
    radiance = emitted.copy()
    for _ in range(_BOUNCES):
        radiance = emitted + albedo / np.pi * (transport @ radiance)
    return radiance

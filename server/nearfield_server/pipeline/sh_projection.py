"""Spherical harmonics of the indirect light around a point (Rohmer et al. 2014, section 4.4, Eq. 10).

The texel behind every cube pixel depends on the pose of the object alone and is traced once per pose; an update reads the
radiance of those texels and leaves out what is direct.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.radiometry.cube import cube_directions, cube_solid_angles
from nearfield_server.radiometry.sh import NUM_COEFFS, sh_basis


@lru_cache(maxsize=4)
def weighted_basis(resolution: int) -> NDArray[np.float64]:
    """(6 R R, 9) float64: Y_k of each cube pixel times its solid angle."""
    return np.asarray(sh_basis(cube_directions(resolution)) * cube_solid_angles(resolution)[:, None])


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _project(probe_texel: Any, basis: Any, radiance: Any, threshold: Any, out: Any) -> None:
    for pixel in range(probe_texel.shape[0]):
        texel = probe_texel[pixel]
        if texel < 0:
            continue
        for channel in range(3):
            value = np.float64(radiance[texel, channel])
            if value >= threshold[channel]:
                value = np.float64(0.0)
            for k in range(NUM_COEFFS):
                out[channel, k] += basis[pixel, k] * value


def project_indirect(
    probe_texel: NDArray[np.int32],
    resolution: int,
    radiance: NDArray[np.float32],
    threshold: NDArray[np.float32],
) -> NDArray[np.float64]:
    """sh_coeffs of the indirect part of the atlas seen from a probe.

    Args:
        probe_texel: (6 R R,) position in texel order behind each cube pixel, or -1 where nothing is (counts as black).
        resolution: R.
        radiance: (N, 3) float32.
        threshold: (3,) float32; channels at or above it are left out.

    Returns:
        (9, 3) float64, world axes.

    Raises:
        ValueError: `probe_texel` does not have 6 R R entries.
    """
    basis = weighted_basis(resolution)
    if probe_texel.shape != (basis.shape[0],):
        raise ValueError(
            f"probe of resolution {resolution} needs {basis.shape[0]} texels, found {probe_texel.shape}"
        )
    out = np.zeros((3, NUM_COEFFS))
    _project(probe_texel, basis, radiance, threshold, out)
    return np.ascontiguousarray(out.T)

"""Spherical harmonics of the indirect light around a point (Rohmer et al. 2014, section 4.4, Eq. 10).

The texel behind every cube pixel depends on the pose of the object alone and is traced once per pose; an update reads the
radiance of those texels and leaves out what is direct.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.pipeline.blocks import FASTMATH
from nearfield_server.radiometry.cube import cube_directions, cube_solid_angles
from nearfield_server.radiometry.half import prefetch
from nearfield_server.radiometry.sh import NUM_COEFFS, sh_basis

_PIXELS_AT_ONCE: Final = 512
_AHEAD: Final = 24


@lru_cache(maxsize=4)
def weighted_basis(resolution: int) -> NDArray[np.float64]:
    """(6 R R, 9) float64: Y_k of each cube pixel times its solid angle."""
    return np.asarray(sh_basis(cube_directions(resolution)) * cube_solid_angles(resolution)[:, None])


@lru_cache(maxsize=4)
def _basis_by_coefficient(resolution: int) -> NDArray[np.float64]:
    """(9, 6 R R): the same, each coefficient in one run of memory."""
    return np.ascontiguousarray(weighted_basis(resolution).T)


@njit(cache=True, nogil=True, fastmath=FASTMATH)  # type: ignore[untyped-decorator]
def _project(probe_texel: Any, basis: Any, radiance: Any, threshold: Any, out: Any) -> None:
    address = radiance.ctypes.data
    num_pixels = probe_texel.shape[0]
    seen = np.empty((3, _PIXELS_AT_ONCE))
    for first in range(0, num_pixels, _PIXELS_AT_ONCE):
        count = min(_PIXELS_AT_ONCE, num_pixels - first)
        for k in range(count):
            # Texels behind neighbouring pixels lie anywhere in memory: ask for them early.
            ahead = probe_texel[min(first + k + _AHEAD, num_pixels - 1)]
            prefetch(address + np.int64(ahead) * 12)
            texel = probe_texel[first + k]
            for channel in range(3):
                value = np.float64(0.0)
                if texel >= 0 and radiance[texel, channel] < threshold[channel]:
                    value = np.float64(radiance[texel, channel])
                seen[channel, k] = value
        for row in range(NUM_COEFFS):
            red, green, blue = 0.0, 0.0, 0.0
            for k in range(count):
                weight = basis[row, first + k]
                red += weight * seen[0, k]
                green += weight * seen[1, k]
                blue += weight * seen[2, k]
            out[row, 0] += red
            out[row, 1] += green
            out[row, 2] += blue


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
    basis = _basis_by_coefficient(resolution)
    if probe_texel.shape != (basis.shape[1],):
        raise ValueError(
            f"probe of resolution {resolution} needs {basis.shape[1]} texels, found {probe_texel.shape}"
        )
    out = np.zeros((NUM_COEFFS, 3))
    _project(probe_texel, basis, radiance, threshold, out)
    return out

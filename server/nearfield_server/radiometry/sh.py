"""Real spherical harmonics of order 2 (nine coefficients), in the basis and order of protocol/CONVENTIONS.md.

Orthonormal, no Condon-Shortley phase, index `k = l^2 + l + m`. Everything is float64.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

NUM_COEFFS: Final = 9
Y0: Final = 0.28209479177387814
Y1: Final = 0.4886025119029199
Y2: Final = 1.0925484305920792
Y20: Final = 0.31539156525252005
Y22: Final = 0.5462742152960396

# Clamped cosine convolved with band l multiplies it by this factor (Ramamoorthi and Hanrahan 2001): pi, 2 pi / 3, pi / 4.
CLAMPED_COSINE: Final[NDArray[np.float64]] = np.repeat([np.pi, 2.0 * np.pi / 3.0, np.pi / 4.0], [1, 3, 5])


def sh_basis(directions: NDArray[np.floating]) -> NDArray[np.float64]:
    """Evaluate the nine basis functions.

    Args:
        directions: (..., 3) unit vectors.

    Returns:
        (..., 9) float64.
    """
    unit = np.asarray(directions, dtype=np.float64)
    x, y, z = unit[..., 0], unit[..., 1], unit[..., 2]
    return np.stack(
        [
            np.full_like(x, Y0),
            Y1 * y,
            Y1 * z,
            Y1 * x,
            Y2 * x * y,
            Y2 * y * z,
            Y20 * (3.0 * z * z - 1.0),
            Y2 * x * z,
            Y22 * (x * x - y * y),
        ],
        axis=-1,
    )


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def sh_basis_into(x: float, y: float, z: float, out: NDArray[np.float64]) -> None:
    """Write the nine basis functions of one unit direction to `out` (9,); for use inside numba kernels."""
    out[0] = Y0
    out[1] = Y1 * y
    out[2] = Y1 * z
    out[3] = Y1 * x
    out[4] = Y2 * x * y
    out[5] = Y2 * y * z
    out[6] = Y20 * (3.0 * z * z - 1.0)
    out[7] = Y2 * x * z
    out[8] = Y22 * (x * x - y * y)


def project_samples(
    directions: NDArray[np.floating], solid_angles: NDArray[np.floating], radiance: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Project sampled radiance: `C_k = sum L(w) Y_k(w) dw` (Rohmer et al. 2014, Eq. 10).

    Args:
        directions: (D, 3) unit vectors away from the receiver.
        solid_angles: (D,) steradians.
        radiance: (D,) or (D, C) per channel.

    Returns:
        (9,) or (9, C) float64 sh_coeffs.
    """
    weighted = sh_basis(directions) * np.asarray(solid_angles, dtype=np.float64)[:, None]
    return np.asarray(weighted.T @ np.asarray(radiance, dtype=np.float64))


def irradiance(sh_coeffs: NDArray[np.floating], normals: NDArray[np.floating]) -> NDArray[np.float64]:
    """Unshadowed irradiance of surfaces: clamped-cosine convolution evaluated along the normals.

    Args:
        sh_coeffs: (9, C) incident radiance coefficients.
        normals: (..., 3) unit, in the axes of the coefficients.

    Returns:
        (..., C) float64.
    """
    transfer = sh_basis(normals) * CLAMPED_COSINE
    return np.asarray(transfer @ np.asarray(sh_coeffs, dtype=np.float64))


def clamped_cosine_coeffs(normal: NDArray[np.floating]) -> NDArray[np.float64]:
    """transfer_coeffs of an unshadowed surface: (..., 9) for unit normals (..., 3) (Eq. 11 with V = 1)."""
    return np.asarray(sh_basis(normal) * CLAMPED_COSINE)


# Symmetric traceless form of band 2: Y_2k(d) = d^T Q_k d for unit d.
_QUADRATIC: Final[NDArray[np.float64]] = np.array(
    [
        [[0.0, 0.5 * Y2, 0.0], [0.5 * Y2, 0.0, 0.0], [0.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, 0.5 * Y2], [0.0, 0.5 * Y2, 0.0]],
        [[-Y20, 0.0, 0.0], [0.0, -Y20, 0.0], [0.0, 0.0, 2.0 * Y20]],
        [[0.0, 0.0, 0.5 * Y2], [0.0, 0.0, 0.0], [0.5 * Y2, 0.0, 0.0]],
        [[Y22, 0.0, 0.0], [0.0, -Y22, 0.0], [0.0, 0.0, 0.0]],
    ]
)


def rotation_matrix(dst_from_src: NDArray[np.floating]) -> NDArray[np.float64]:
    """The (9, 9) matrix that carries coefficients of a function from source axes to destination axes.

    A function f given in source axes becomes g(d) = f(src_from_dst d); `coeffs_dst = matrix @ coeffs_src`.

    Args:
        dst_from_src: (3, 3) rotation.
    """
    rotation = np.asarray(dst_from_src, dtype=np.float64)
    matrix = np.zeros((NUM_COEFFS, NUM_COEFFS))
    matrix[0, 0] = 1.0
    # Band 1 is the vector (y, z, x).
    order = np.array([1, 2, 0])
    matrix[1:4, 1:4] = rotation[np.ix_(order, order)]
    # Band 2 is a symmetric traceless tensor: rotate each basis tensor, then read its coefficients (Q is orthogonal).
    rotated = np.einsum("ab,kbc,dc->kad", rotation, _QUADRATIC, rotation)
    norm = np.einsum("kab,kab->k", _QUADRATIC, _QUADRATIC)
    matrix[4:, 4:] = np.einsum("jab,kab->jk", _QUADRATIC, rotated) / norm[:, None]
    return matrix


def rotate_sh(sh_coeffs: NDArray[np.floating], dst_from_src: NDArray[np.floating]) -> NDArray[np.float64]:
    """Express (9,) or (9, C) coefficients in other axes; see `rotation_matrix`."""
    return np.asarray(rotation_matrix(dst_from_src) @ np.asarray(sh_coeffs, dtype=np.float64))

"""Integration of direct texels into virtual area lights (Rohmer et al. 2014, section 4.3, Eq. 7).

Every direct texel goes to its nearest centre; blocks of texels first rule out centres that cannot be nearest to any of
theirs. Sums are float64, so the VALs hold the direct energy of the atlas to about 1e-13.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.pipeline.blocks import (
    BLOCK,
    NORMAL_SCALE,
    BlockPool,
    TexelBlocks,
    direct_blocks,
    num_chunks_for,
)
from nearfield_server.pipeline.sampling import direct_weight

# Columns of the sums: I (3), grey weight, weight * position (3), weight * normal (3), weight * dA,
# weight * position_i * position_j (xx, yy, zz, xy, yz, zx).
_COLUMNS: Final = 17
_BLOCKS_PER_CHUNK: Final = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class ValSums:
    """Integrated lights, float64. Slots without light are all zero.

    Attributes:
        radiant_intensity: (M, 3) W/sr, I = sum L dA over the direct channels.
        position: (M, 3) energy-weighted centre. normal: (M, 3) energy-weighted mean, unit.
        area: (M,) m^2, the disc with the same second moment, see `integrate`.
    """

    radiant_intensity: NDArray[np.float64]
    position: NDArray[np.float64]
    normal: NDArray[np.float64]
    area: NDArray[np.float64]


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _candidates(centre: Any, radius: float, centres: Any, slots: Any, distance: Any) -> int:
    """Slots whose centre can be nearest to a point within `radius` of `centre`."""
    best = np.inf
    for slot in range(centres.shape[0]):
        total = 0.0
        for axis in range(6):
            total += (centres[slot, axis] - centre[axis]) ** 2
        distance[slot] = np.sqrt(total)
        best = min(best, distance[slot])
    count = 0
    # A hair is added so that rounding never rules out the true nearest centre.
    limit = best + 2.0 * radius + 1e-9 * (1.0 + best)
    for slot in range(centres.shape[0]):
        if distance[slot] <= limit:
            slots[count] = slot
            count += 1
    return count


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _integrate_blocks(
    chunk: int,
    first: int,
    last: int,
    blocks: Any,
    radiance: Any,
    position: Any,
    normal: Any,
    area: Any,
    block_centre: Any,
    block_radius: Any,
    threshold: Any,
    centres: Any,
    origin: Any,
    sums: Any,
) -> None:
    slots = np.empty(centres.shape[0], dtype=np.int64)
    distance = np.empty(centres.shape[0])
    for position_in_list in range(first, last):
        block = blocks[position_in_list]
        count = _candidates(block_centre[block], block_radius[block], centres, slots, distance)
        stop = min((block + 1) * BLOCK, area.shape[0])
        for texel in range(block * BLOCK, stop):
            weight = direct_weight(radiance, area, threshold, texel)
            if not weight > 0.0:
                continue
            chosen = slots[0]
            if count > 1:
                best = np.inf
                for k in range(count):
                    slot = slots[k]
                    total = 0.0
                    for axis in range(3):
                        total += (position[texel, axis] - centres[slot, axis]) ** 2
                        total += (NORMAL_SCALE * normal[texel, axis] - centres[slot, 3 + axis]) ** 2
                    if total < best:
                        best, chosen = total, slot
            _add_texel(
                sums[chunk, chosen], radiance, position, normal, area, threshold, origin, weight, texel
            )


@njit(cache=True, nogil=True, inline="always")  # type: ignore[untyped-decorator]
def _add_texel(
    row: Any,
    radiance: Any,
    position: Any,
    normal: Any,
    area: Any,
    threshold: Any,
    origin: Any,
    weight: float,
    texel: int,
) -> None:
    patch = np.float64(area[texel])
    for channel in range(3):
        if radiance[texel, channel] >= threshold[channel]:
            row[channel] += np.float64(radiance[texel, channel]) * patch
    x = position[texel, 0] - origin[0]
    y = position[texel, 1] - origin[1]
    z = position[texel, 2] - origin[2]
    row[3] += weight
    row[4] += weight * x
    row[5] += weight * y
    row[6] += weight * z
    row[7] += weight * normal[texel, 0]
    row[8] += weight * normal[texel, 1]
    row[9] += weight * normal[texel, 2]
    row[10] += weight * patch
    row[11] += weight * x * x
    row[12] += weight * y * y
    row[13] += weight * z * z
    row[14] += weight * x * y
    row[15] += weight * y * z
    row[16] += weight * z * x


def integrate(
    blocks: TexelBlocks,
    radiance: NDArray[np.float32],
    block_max: NDArray[np.float32],
    threshold: NDArray[np.float32],
    centres: NDArray[np.float64],
    alive: NDArray[np.bool_],
    pool: BlockPool,
) -> ValSums:
    """Sum every direct texel into the VAL of its nearest living centre.

    The area is that of the disc whose second moment, within the plane across the mean normal, equals that of the
    cluster's direct energy: `A = 2 pi <rho^2> + mean dA`, with rho the distance from the centre across the normal (a
    uniform disc has <rho^2> = A / (2 pi); each texel counts as a small disc of its own). With it the irradiance on the
    axis agrees with Eq. 5 to second order in size / distance, for elongated and for scattered clusters too, where the
    plain sum of areas does not.

    Args:
        blocks: static texel data.
        radiance: (N, 3).
        block_max: (B, 3).
        threshold: (3,).
        centres: (M, 6) in cluster space.
        alive: (M,).
        pool: threads.

    Returns:
        The lights in slot order.
    """
    num_slots = centres.shape[0]
    living = np.flatnonzero(alive)
    sums = np.zeros((num_slots, _COLUMNS))
    if living.size:
        direct = direct_blocks(block_max, threshold)
        num_chunks = num_chunks_for(direct.size, _BLOCKS_PER_CHUNK)
        partial = np.zeros((num_chunks, living.size, _COLUMNS))
        pool.run(
            _integrate_blocks,
            direct.size,
            direct,
            radiance,
            blocks.position,
            blocks.normal,
            blocks.area,
            blocks.block_centre,
            blocks.block_radius,
            threshold,
            np.ascontiguousarray(centres[living]),
            blocks.origin,
            partial,
            num_chunks=num_chunks,
        )
        sums[living] = partial.sum(axis=0)
    return lights_from_sums(sums, blocks.origin, centres)


def lights_from_sums(
    sums: NDArray[np.float64], origin: NDArray[np.float64], centres: NDArray[np.float64]
) -> ValSums:
    """Lights in slot order from the (M, 17) float64 sums over direct texels, positions relative to `origin`."""
    weight = sums[:, 3]
    lit = weight > 0.0
    inverse = np.where(lit, 1.0 / np.where(lit, weight, 1.0), 0.0)[:, None]
    mean = sums[:, 4:7] * inverse
    normal = sums[:, 7:10] * inverse
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    # Normals that cancel (a closed shape in one cluster) have no mean: fall back to the centre's, then to straight down.
    for fallback in (centres[:, 3:], np.array([0.0, -1.0, 0.0])):
        normal = np.where(length > 1e-6, normal, fallback)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(lit[:, None], normal / length, 0.0)
    moments = sums[:, [11, 14, 16, 14, 12, 15, 16, 15, 13]].reshape(-1, 3, 3) * inverse[..., None]
    covariance = moments - mean[:, :, None] * mean[:, None, :]
    across = np.trace(covariance, axis1=1, axis2=2) - np.einsum("mi,mij,mj->m", normal, covariance, normal)
    area = 2.0 * np.pi * np.maximum(across, 0.0) + sums[:, 10] * inverse[:, 0]
    return ValSums(
        radiant_intensity=sums[:, :3].copy(),
        position=np.where(lit[:, None], mean + origin, 0.0),
        normal=normal,
        area=np.where(lit, area, 0.0),
    )

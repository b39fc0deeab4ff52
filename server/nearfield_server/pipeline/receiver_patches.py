"""Patches of texels around the receivers that betray a hidden lamp: their mean is far less noisy than a single texel.

One texel shows about one pixel of one camera. The radiance of a hidden lamp is a difference of such values divided by a form
factor, so that one per cent of pixel noise became several per cent of the lamp's light.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.records import RoomMesh, TexelGeometry

PATCH_TEXELS: Final = 16
_WINDOW: Final = 6
"""Texels of the atlas to either side of a receiver that may belong to its patch."""
_ALIKE: Final = 0.999
"""Least cosine between the normals of a patch."""
_GOLDEN_ANGLE: Final = np.pi * (3.0 - 5.0**0.5)


def find_patches(
    mesh: RoomMesh,
    texels: TexelGeometry,
    usable: NDArray[np.bool_],
    receiver: NDArray[np.int32],
    reach: NDArray[np.float64],
) -> NDArray[np.int32]:
    """Texels spread over a small disc around each receiver, on the same material and facing the same way.

    Args:
        mesh: room.
        texels: its texels.
        usable: (N,) texels that cameras see well enough.
        receiver: (R,) centres, usable.
        reach: (R,) radius of each disc, metres: small against the distance of the lamp, so that the mean stands for the centre.

    Returns:
        (R, PATCH_TEXELS) int32; texels repeat where a disc holds fewer.
    """
    near, member = _neighbours(texels, receiver)
    material = mesh.face_material[texels.face]
    normal = texels.normal[receiver].astype(np.float64)
    offset = texels.position[near].astype(np.float64) - texels.position[receiver, None].astype(np.float64)
    member &= usable[near] & (material[near] == material[receiver, None])
    member &= np.einsum("rki,ri->rk", texels.normal[near], normal) > _ALIKE
    member &= np.linalg.norm(offset, axis=2) <= reach[:, None]
    member |= near == receiver[:, None]
    # The disc must fit into the window, or its rim would snap to one side of it.
    radius = np.linalg.norm(np.where(member[..., None], offset, 0.0), axis=2).max(axis=1)
    patch = np.empty((receiver.size, PATCH_TEXELS), dtype=np.int32)
    for k, target in enumerate(_disc_points(normal)):
        distance = np.linalg.norm(offset - (radius[:, None] * target)[:, None], axis=2)
        nearest = np.where(member, distance, np.inf).argmin(axis=1)
        patch[:, k] = near[np.arange(receiver.size), nearest]
    return patch


def _neighbours(
    texels: TexelGeometry, receiver: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """(R, W) texels in a window of the atlas around each receiver, and which of them exist."""
    step = np.arange(-_WINDOW, _WINDOW + 1)
    row, column = np.divmod(texels.texel_index[receiver], texels.width)
    rows, columns = row[:, None, None] + step[:, None], column[:, None, None] + step
    inside = (rows >= 0) & (rows < texels.height) & (columns >= 0) & (columns < texels.width)
    near = texels.lookup[rows.clip(0, texels.height - 1), columns.clip(0, texels.width - 1)]
    near = near.reshape(receiver.size, -1)
    return near, inside.reshape(receiver.size, -1) & (near >= 0)


def _disc_points(normal: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Vogel's spiral and its mirror image in unit discs across (R, 3) normals: PATCH_TEXELS arrays (R, 3), of mean 0."""
    helper = np.where(np.abs(normal[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(normal, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normal, first)
    half = PATCH_TEXELS // 2
    points = []
    for k in range(half):
        radius, angle = np.sqrt((k + 0.5) / half), k * _GOLDEN_ANGLE
        points.append(radius * (np.cos(angle) * first + np.sin(angle) * second))
    return points + [-point for point in points]

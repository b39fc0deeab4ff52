"""Which triangle covers which atlas texel: exact sampling at texel centres with the top-left rule.

Vertices are snapped to 1/4096 texel and edges are evaluated in 64-bit integers, so a texel centre on an edge that two
triangles share belongs to exactly one of them, and no centre is missed or counted twice.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

SUBTEXELS = 4096
# Two charts overlap where a texel centre lies deeper than this (in texels) inside both triangles; shared borders that
# differ by rounding do not count.
OVERLAP_DEPTH = 0.05


class UvCoverage(NamedTuple):
    """Result of `cover_texels`.

    Attributes:
        face: (height, width) int32, triangle that owns the texel, or -1.
        num_overlaps: texels that lie deep inside two triangles.
    """

    face: NDArray[np.int32]
    num_overlaps: int


def cover_texels(uv: NDArray[np.float64], faces: NDArray[np.int32], height: int, width: int) -> UvCoverage:
    """Rasterise the UV layout.

    Args:
        uv: (V, 2), glTF convention; parts outside [0, 1] cover nothing.
        faces: (F, 3), either orientation.
        height: atlas rows.
        width: atlas columns.
    """
    scaled = uv * np.array([width, height], dtype=np.float64)
    # Texel centres are at half-integers; far outside positions are clamped so that products stay within 64 bits.
    limit = 4.0 * max(width, height)
    snapped = np.rint(np.clip(scaled, -limit, limit) * SUBTEXELS).astype(np.int64)
    face = np.full((height, width), -1, dtype=np.int32)
    depth = np.zeros((height, width), dtype=np.float32)
    num_overlaps = _cover(snapped, np.ascontiguousarray(faces, dtype=np.int32), face, depth)
    return UvCoverage(face, int(num_overlaps))


@njit(cache=True, nogil=True)
def _cover(snapped, faces, owner, depth):  # type: ignore[no-untyped-def]  # pragma: no cover
    height, width = owner.shape
    half, one = SUBTEXELS // 2, SUBTEXELS
    overlaps = 0
    for f in range(faces.shape[0]):
        ax, ay = snapped[faces[f, 0], 0], snapped[faces[f, 0], 1]
        bx, by = snapped[faces[f, 1], 0], snapped[faces[f, 1], 1]
        cx, cy = snapped[faces[f, 2], 0], snapped[faces[f, 2], 1]
        double_area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if double_area == 0:
            continue
        if double_area < 0:
            bx, by, cx, cy = cx, cy, bx, by
        first_column = max(0, (min(ax, bx, cx) - half) // one)
        last_column = min(width - 1, (max(ax, bx, cx) - half) // one + 1)
        first_row = max(0, (min(ay, by, cy) - half) // one)
        last_row = min(height - 1, (max(ay, by, cy) - half) // one + 1)
        # Rows grow downwards and the winding is clockwise on screen, so an edge is "top" when it runs to the right along
        # a row and "left" when it runs upwards.
        bias_ab = 0 if (by < ay or (by == ay and bx > ax)) else -1
        bias_bc = 0 if (cy < by or (cy == by and cx > bx)) else -1
        bias_ca = 0 if (ay < cy or (ay == cy and ax > cx)) else -1
        length_ab = np.hypot(float(bx - ax), float(by - ay))
        length_bc = np.hypot(float(cx - bx), float(cy - by))
        length_ca = np.hypot(float(ax - cx), float(ay - cy))
        for row in range(first_row, last_row + 1):
            y = row * one + half
            for column in range(first_column, last_column + 1):
                x = column * one + half
                edge_ab = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
                edge_bc = (cx - bx) * (y - by) - (cy - by) * (x - bx)
                edge_ca = (ax - cx) * (y - cy) - (ay - cy) * (x - cx)
                if edge_ab + bias_ab < 0 or edge_bc + bias_bc < 0 or edge_ca + bias_ca < 0:
                    continue
                inside = min(edge_ab / length_ab, edge_bc / length_bc, edge_ca / length_ca) / one
                if owner[row, column] >= 0:
                    if min(inside, depth[row, column]) > OVERLAP_DEPTH:
                        overlaps += 1
                    if inside <= depth[row, column]:
                        continue
                owner[row, column] = f
                depth[row, column] = inside
    return overlaps

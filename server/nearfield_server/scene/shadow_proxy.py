"""Shadow proxy: a copy of a virtual object of a few hundred triangles, drawn into the shadow maps instead of the object."""

from __future__ import annotations

from dataclasses import dataclass

import fast_simplification
import numpy as np
from numpy.typing import NDArray

MAX_FACES = 600
TARGET_FACES = 500
# Gentle first: it keeps the silhouette better, but may stop before the target.
_AGGRESSIVENESS = (4, 5, 6, 7, 8)
_MAX_CHECKED_POINTS = 4000
_PAIRS_PER_BATCH = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadowProxy:
    """A decimated mesh in object axes.

    Attributes:
        positions: (V, 3) float64, metres. faces: (F, 3) int32.
        hausdorff: greatest distance between the two surfaces, from the vertices of each to the other, metres; 0 when the model
        itself is used.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    hausdorff: float


def make_shadow_proxy(
    positions: NDArray[np.floating], faces: NDArray[np.integer], *, target_faces: int = TARGET_FACES
) -> ShadowProxy:
    """Decimate a mesh (quadric error), or keep it when it is small enough already.

    Vertices at equal positions (texture or normal seams) are welded first; without that the decimation would tear seams open.

    Args:
        positions: (V, 3) object frame, metres.
        faces: (F, 3).
        target_faces: about how many faces to keep.
    """
    points, index = np.unique(np.asarray(positions, np.float64), axis=0, return_inverse=True)
    welded = index.reshape(-1)[np.asarray(faces)]
    welded = welded[
        (welded[:, 0] != welded[:, 1]) & (welded[:, 1] != welded[:, 2]) & (welded[:, 2] != welded[:, 0])
    ]
    whole = ShadowProxy(positions=points, faces=welded.astype(np.int32), hausdorff=0.0)
    if len(welded) <= MAX_FACES:
        return whole
    # The simplifier works in float32: bring the model to unit size about its centre.
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    scale = float(np.max(np.abs(points - centre)))
    unit = ((points - centre) / scale).astype(np.float32)
    for aggressiveness in _AGGRESSIVENESS:
        small, small_faces = fast_simplification.simplify(
            unit, welded.astype(np.int32), target_count=target_faces, agg=aggressiveness
        )
        if len(small_faces) <= MAX_FACES:
            break
    if len(small_faces) < 4:
        return whole
    proxy = np.asarray(small, np.float64) * scale + centre
    error = max(
        distance_to_mesh(_subset(points), proxy, small_faces).max(),
        distance_to_mesh(proxy, points, welded).max(),
    )
    return ShadowProxy(positions=proxy, faces=np.asarray(small_faces, np.int32), hausdorff=float(error))


def distance_to_mesh(
    points: NDArray[np.floating], positions: NDArray[np.floating], faces: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Exact distance of points to the surface of a mesh, by comparing with every triangle: (n, 3) -> (n,)."""
    a, b, c = (np.asarray(positions, np.float64)[faces[:, i]] for i in range(3))
    result = np.empty(len(points))
    batch = max(1, _PAIRS_PER_BATCH // len(faces))
    for start in range(0, len(points), batch):
        p = np.asarray(points[start : start + batch], np.float64)[:, None]
        edges = np.minimum.reduce(
            [_squared_to_segment(p, a, b), _squared_to_segment(p, b, c), _squared_to_segment(p, c, a)]
        )
        result[start : start + batch] = np.sqrt(
            np.minimum(edges, _squared_to_interior(p, a, b, c)).min(axis=1)
        )
    return result


def _squared_to_segment(
    p: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Squared distance of p (n, 1, 3) to segments (f, 3): (n, f)."""
    edge = b - a
    along = np.einsum("nfi,fi->nf", p - a, edge) / np.maximum(np.einsum("fi,fi->f", edge, edge), 1e-300)
    gap = p - a - np.clip(along, 0.0, 1.0)[..., None] * edge
    return np.asarray(np.einsum("nfi,nfi->nf", gap, gap))


def _squared_to_interior(
    p: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Squared distance of p (n, 1, 3) to the planes of triangles (f, 3) where the foot lies inside, else infinity: (n, f)."""
    normal = np.cross(b - a, c - a)
    squared = np.maximum(np.einsum("fi,fi->f", normal, normal), 1e-300)
    inside = np.ones(p.shape[:1] + a.shape[:1], np.bool_)
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("nfi,fi->nf", p - start, np.cross(normal, end - start)) >= 0.0
    height = np.einsum("nfi,fi->nf", p - a, normal)
    return np.where(inside, height * height / squared, np.inf)


def _subset(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """All points, or an even choice of them where there are very many."""
    return points[:: max(1, len(points) // _MAX_CHECKED_POINTS)]

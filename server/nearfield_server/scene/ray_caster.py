"""Ray casting against one triangle mesh (Embree), in the batch sizes that keep its temporary arrays small."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

_BATCH = 1 << 20


class RayHits(NamedTuple):
    """Closest hits: `face` (n,) int32 or -1, barycentric `u`, `v` (n,) of the second and third corner, `distance` (n,)."""

    face: NDArray[np.int32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    distance: NDArray[np.float32]


class RayCaster:
    """A static triangle mesh that answers closest-hit and any-hit queries in float32.

    Args:
        positions: (V, 3) metres, any one frame.
        faces: (F, 3) indices into `positions`, at least one.
    """

    def __init__(self, positions: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        # Robust mode: without it rays through shared edges can slip between two faces.
        self._scene = EmbreeScene(robust=True)
        self._mesh = TriangleMesh(
            self._scene,
            np.ascontiguousarray(positions, dtype=np.float32),
            np.ascontiguousarray(faces, dtype=np.int32),
        )

    def closest(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> RayHits:
        """First hit of each ray.

        Args:
            origins: (n, 3).
            directions: (n, 3), unit.
        """
        n = len(origins)
        hits = RayHits(
            np.full(n, -1, np.int32),
            np.zeros(n, np.float32),
            np.zeros(n, np.float32),
            np.full(n, np.inf, np.float32),
        )
        for start in range(0, n, _BATCH):
            part = slice(start, min(start + _BATCH, n))
            found = self._scene.run(
                np.ascontiguousarray(origins[part], dtype=np.float32),
                np.ascontiguousarray(directions[part], dtype=np.float32),
                query="INTERSECT",
                output=True,
            )
            hits.face[part] = found["primID"]
            hits.u[part] = found["u"]
            hits.v[part] = found["v"]
            hits.distance[part] = np.where(found["primID"] >= 0, found["tfar"], np.inf)
        return hits

    def blocked(
        self,
        origins: NDArray[np.floating],
        directions: NDArray[np.floating],
        distances: NDArray[np.floating] | None = None,
    ) -> NDArray[np.bool_]:
        """Whether anything lies on each ray.

        Args:
            origins: (n, 3).
            directions: (n, 3), unit.
            distances: (n,) length of each ray, metres; None looks to infinity.
        """
        n = len(origins)
        result = np.zeros(n, np.bool_)
        for start in range(0, n, _BATCH):
            part = slice(start, min(start + _BATCH, n))
            limit = None if distances is None else np.ascontiguousarray(distances[part], dtype=np.float32)
            found = self._scene.run(
                np.ascontiguousarray(origins[part], dtype=np.float32),
                np.ascontiguousarray(directions[part], dtype=np.float32),
                limit,
                query="OCCLUDED",
            )
            result[part] = found >= 0
        return result

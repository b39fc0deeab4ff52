"""The radiance of hidden lamps in plain float64 numpy: the oracle of `pipeline.hidden_light.estimate_hidden_radiance`.

The static data (who sees whom) is an input; what is made of a radiance atlas is written here a second time, without the
bookkeeping that spares the fast version most of its work.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nearfield_server.pipeline.hidden_light import (
    BELIEF_SHARE,
    BELIEF_SPREAD,
    MIN_RECEIVERS,
    HiddenLight,
)
from nearfield_server.radiometry.half import HALF_MAX


def estimate_hidden_radiance_reference(
    hidden: HiddenLight, radiance: NDArray[np.floating]
) -> NDArray[np.float64]:
    """(G, 3) radiance of every hidden surface; arguments as for the fast version, all evidence anew in every round."""
    atlas = radiance.astype(np.float64)
    arriving = atlas[hidden.receiver].mean(axis=1) * hidden.inverse_albedo
    ray_receiver = np.repeat(np.arange(len(hidden.receiver)), np.diff(hidden.ray_start))
    seen = hidden.ray_weight.astype(np.float64)[:, None] * atlas[hidden.ray_texel]
    visible = np.stack(
        [np.bincount(ray_receiver, seen[:, channel], len(hidden.receiver)) for channel in range(3)], axis=1
    )
    missing = arriving - visible
    result = np.zeros((hidden.num_groups, 3))
    closed: set[int] = set()
    while True:
        candidates = {
            surface: found
            for surface in range(hidden.num_groups)
            if surface not in closed and (found := _believed(hidden, surface, arriving, missing)) is not None
        }
        if not candidates:
            return np.minimum(result, HALF_MAX)
        best = max(candidates, key=lambda surface: float(candidates[surface].sum()))
        result[best] = candidates[best]
        closed.add(best)
        missing = missing - hidden.form_factor[:, best, None] * result[best]


def _believed(
    hidden: HiddenLight,
    surface: int,
    arriving: NDArray[np.float64],
    missing: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Radiance (3,) of a surface, or None where its receivers do not testify to it."""
    rows = np.arange(hidden.group_rows[surface], hidden.group_rows[surface + 1])
    rows = rows[(hidden.form_factor[rows, surface] > 0.0) & (arriving[rows].sum(axis=1) > 0.0)]
    if rows.size < MIN_RECEIVERS:
        return None
    factor = hidden.form_factor[rows, surface]
    radiance = np.maximum(np.median(missing[rows] / factor[:, None], axis=0), 0.0)
    total = radiance.sum()
    if not total > 0.0:
        return None
    grey = missing[rows].sum(axis=1) / factor
    spread = np.median(np.abs(grey - np.median(grey))) / total
    share = np.median(factor / arriving[rows].sum(axis=1)) * total
    belief = np.interp(share, BELIEF_SHARE, [0.0, 1.0]) * np.interp(spread, BELIEF_SPREAD[::-1], [1.0, 0.0])
    return np.asarray(belief * radiance) if belief > 0.0 else None

"""How much the picture and the lights move when nothing but the cameras' noise does."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nearfield_server.radiometry.image_metrics import display


def flicker(composites: Sequence[NDArray[np.floating]], exposure: float) -> float:
    """Mean over frames, pixels and channels of |difference of consecutive pictures|, in 1/255 of the display's range.

    Args:
        composites: (H, W, 3) linear each, at least two.
        exposure: display exposure.

    Raises:
        ValueError: there are fewer than two pictures.
    """
    if len(composites) < 2:
        raise ValueError(f"flicker needs two pictures or more, found {len(composites)}")
    shown = [display(composite, exposure) for composite in composites]
    steps = [np.abs(after - before).mean() for before, after in itertools.pairwise(shown)]
    return float(255.0 * np.mean(steps))


def val_movement_mm(moments: Sequence[NDArray[np.void]]) -> float:
    """Furthest that a light moved between consecutive moments, in millimetres; 0 where no light stays the same one.

    Lights are the same where slot and generation are.

    Args:
        moments: VAL_DTYPE each.
    """
    furthest = 0.0
    for before, after in itertools.pairwise(moments):
        count = min(len(before), len(after))
        old, new = before[:count], after[:count]
        lit = old["radiant_intensity"].any(axis=1) & new["radiant_intensity"].any(axis=1)
        same = lit & (old["generation"] == new["generation"])
        if same.any():
            step = np.linalg.norm(new["position"][same] - old["position"][same], axis=1)
            furthest = max(furthest, 1e3 * float(step.max()))
    return furthest

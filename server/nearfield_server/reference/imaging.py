"""Sensor codes to radiance, in float64 and whole pictures: the oracles of `imaging`, written from the definitions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_F64 = NDArray[np.float64]


def merged_samples(
    signals: Sequence[_F64], is_saturated: Sequence[NDArray[np.bool_]], amounts: Sequence[float]
) -> tuple[_F64, NDArray[np.bool_]]:
    """Merge exposures sample by sample, see `imaging.hdr_merge`.

    Args:
        signals: (...) of each exposure.
        is_saturated: likewise.
        amounts: seconds times gain of each.

    Returns:
        (signal per second at a gain of 1, whether that is only a lower bound).
    """
    signal, amount = np.stack(signals), np.array(amounts).reshape(-1, *[1] * np.ndim(signals[0]))
    valid = ~np.stack(is_saturated)
    weight = (valid * amount**2).sum(0)
    estimate = (valid * amount * signal).sum(0) / np.where(weight > 0, weight, 1.0)
    lower_bound = (signal / amount).max(0, initial=-np.inf, where=~valid)
    return np.where(weight > 0, estimate, lower_bound), weight == 0


def _shifted(plane: _F64, rows: int, columns: int) -> _F64:
    """Value of each pixel's neighbour at (row + rows, column + columns), mirrored about the outermost pixels."""
    height, width = plane.shape
    padded = np.pad(plane, 2, mode="reflect")
    return padded[2 + rows : 2 + rows + height, 2 + columns : 2 + columns + width]


def _colour_masks(shape: tuple[int, int], bayer: str) -> dict[str, NDArray[np.bool_]]:
    masks = {name: np.zeros(shape, np.bool_) for name in "RGB"}
    for index, name in enumerate(bayer):
        masks[name][index // 2 :: 2, index % 2 :: 2] = True
    return masks


def mosaic(picture: _F64, bayer: str) -> _F64:
    """(H, W) samples of a picture (H, W, 3) behind a colour filter array, see `PixelFormat.bayer`."""
    masks = _colour_masks(picture.shape[:2], bayer)
    return np.asarray(sum(picture[..., channel] * masks[name] for channel, name in enumerate("RGB")))


def demosaicked(samples: _F64, bayer: str, offset: float) -> _F64:
    """(H, W, 3) of a mosaic (H, W), see `imaging.demosaic`; slightly negative where samples are."""
    masks = _colour_masks(samples.shape, bayer)
    raised = np.maximum(samples + offset, 0.25 * offset)
    estimates, changes = [], []
    for first, second in (((0, -1), (0, 1)), ((-1, 0), (1, 0))):
        one, other = _shifted(raised, *first), _shifted(raised, *second)
        same = 0.5 * (_shifted(raised, *np.multiply(2, first)) + _shifted(raised, *np.multiply(2, second)))
        estimates.append(0.5 * (one + other) * raised / (0.5 * (raised + same)))
        changes.append(np.abs(one - other) + 2.0 * np.abs(raised - same) + offset)
    weights = [changes[1] ** 2, changes[0] ** 2]
    blend = (weights[0] * estimates[0] + weights[1] * estimates[1]) / (weights[0] + weights[1])
    green = np.where(masks["G"], raised, blend)

    def carried(steps: Sequence[tuple[int, int]]) -> _F64:
        colours = np.mean([_shifted(raised, *step) for step in steps], axis=0)
        greens = np.mean([_shifted(green, *step) for step in steps], axis=0)
        return np.asarray(np.minimum(green * colours / greens, 2.0 * np.maximum(green, colours)))

    diagonal = carried([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    beside, above = carried([(0, -1), (0, 1)]), carried([(-1, 0), (1, 0)])
    out = np.empty((*samples.shape, 3))
    out[..., 1] = green
    for channel, name, opposite in ((0, "R", "B"), (2, "B", "R")):
        in_row = np.any(masks[name], axis=1, keepdims=True)
        found = np.where(masks[opposite], diagonal, np.where(in_row, beside, above))
        out[..., channel] = np.where(masks[name], raised, found)
    return out - offset

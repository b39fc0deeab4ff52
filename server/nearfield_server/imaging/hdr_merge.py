"""Several exposures of one scene as one picture, merged on the mosaic, before colours are interpolated.

Each exposure k measures a signal s_k = amount_k x plus noise of the relative radiance x, unless it is saturated. The merged value is
the least-squares estimate over those that are not:

    x = sum(amount_k s_k) / sum(amount_k^2)

Its weights amount_k^2 are optimal where read noise and quantisation dominate, that is in the dark, where noise hurts. Where photon noise
dominates, the optimum are weights amount_k; the square then adds at most 12 % to the noise of the optimum (four exposures a factor 2
apart; 3 % a factor 16 apart). Weights amount_k in the dark would double the noise of four exposures, so the square is the safer choice
and needs no noise model. Weights never depend on the sample that they weigh: that would bias the result.

The only choice that looks at the samples is the cut at the saturation threshold. A pixel whose expected code lies within a standard
deviation of it counts only when its noise was negative, and comes out too dark by at most 0.8 standard deviations of a nearly full
pixel: below 1 % for a full well of 10 000 electrons, over 2 % of the range. A smooth roll-off makes this no smaller, only wider: its weight
follows the noise too.

A pixel saturated in every exposure keeps the lower bound that the shortest one gives, and is flagged. It never turns black.

With a black level above 0, noise around darkness stays symmetric and averages to 0. A converter that cuts at code 0 leaves only the
positive half: up to 0.4 standard deviations of the read noise of the longest exposure, which no merge can take back. Set a black level.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.errors import CaptureError


@njit(cache=True, nogil=True, fastmath={"nnan", "nsz"})  # type: ignore[untyped-decorator]
def add_row(
    codes: NDArray[np.uint16],
    lookup: NDArray[np.float32],
    saturated_from: int,
    amount: float,
    is_first: bool,
    sums: NDArray[np.float32],
) -> None:
    """Add one exposure to a row of samples.

    Args:
        codes: (n,) uint16.
        lookup: (65536,) float32, signal of a code.
        saturated_from: the least code that is only a lower bound.
        amount: of the exposure, in the unit of the result.
        is_first: the sums begin with this exposure.
        sums: (4, n) float32: amount times signal, squared amount, the greatest lower bound; the last row is scratch.
    """
    weighted, weight, bound, signal = sums[0], sums[1], sums[2], sums[3]
    factor, square, inverse = np.float32(amount), np.float32(amount * amount), np.float32(1.0 / amount)
    zero = np.float32(0.0)
    limit = np.uint16(saturated_from)
    if is_first:
        sums[:3] = zero
    # The lookup in a loop of its own: the others are vector instructions then.
    num_saturated = 0
    for index in range(codes.shape[0]):
        signal[index] = lookup[codes[index]]
    for index in range(codes.shape[0]):
        num_saturated += codes[index] >= limit
    if num_saturated == 0:
        for index in range(codes.shape[0]):
            weighted[index] += factor * signal[index]
            weight[index] += square
        return
    for index in range(codes.shape[0]):
        is_valid = codes[index] < limit
        weighted[index] += factor * signal[index] if is_valid else zero
        weight[index] += square if is_valid else zero
        bound[index] = max(bound[index], zero if is_valid else signal[index] * inverse)


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def end_row(sums: NDArray[np.float32], out: NDArray[np.float32], is_bound: NDArray[np.uint8]) -> int:
    """Turn the sums into values (n,) and flags (n,); returns the number of flagged samples."""
    weighted, weight, bound = sums[0], sums[1], sums[2]
    count = np.int64(0)
    for index in range(out.shape[0]):
        nothing = weight[index] == np.float32(0.0)
        out[index] = bound[index] if nothing else weighted[index] / weight[index]
        is_bound[index] = np.uint8(nothing)
        count += np.int64(nothing)
    return int(count)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _merge_planes(
    codes: NDArray[np.uint16],
    lookup: NDArray[np.float32],
    saturated_from: int,
    amounts: NDArray[np.float64],
    out: NDArray[np.float32],
    is_bound: NDArray[np.uint8],
) -> int:
    sums = np.empty((4, codes.shape[2]), np.float32)
    count = np.int64(0)
    for row in range(codes.shape[1]):
        for exposure in range(codes.shape[0]):
            add_row(codes[exposure, row], lookup, saturated_from, amounts[exposure], exposure == 0, sums)
        count += end_row(sums, out[row], is_bound[row])
    return int(count)


def check_amounts(amounts: Sequence[float]) -> NDArray[np.float64]:
    """(N,) float64, all finite and above 0.

    Raises:
        CaptureError: they are not.
    """
    checked = np.array(amounts, np.float64)
    if checked.ndim != 1 or checked.size == 0 or not np.all((checked > 0.0) & np.isfinite(checked)):
        raise CaptureError(f"exposures: expected seconds times gain above 0, found {list(amounts)}")
    return checked


def merge(
    codes: NDArray[np.uint16], lookup: NDArray[np.float32], saturated_from: int, amounts: Sequence[float]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Merge whole pictures.

    Args:
        codes: (N, H, W) uint16, one picture per exposure.
        lookup: (65536,) float32, signal of a code, see `response`.
        saturated_from: the least code that is only a lower bound.
        amounts: (N,) seconds times gain; any order.

    Returns:
        (H, W) float32, signal per second at a gain of 1, which may be slightly negative in the dark; and (H, W) bool, where it is only
        a lower bound because every exposure is saturated.

    Raises:
        CaptureError: amounts that are no exposures, or not one per picture.
    """
    checked = check_amounts(amounts)
    if codes.ndim != 3 or len(codes) != len(checked):
        raise CaptureError(f"merge: pictures of shape {codes.shape} for {len(checked)} exposures")
    # Relative to the longest, so that squares stay far inside the range of float32.
    longest = float(checked.max())
    out = np.empty(codes.shape[1:], np.float32)
    is_bound = np.empty(codes.shape[1:], np.uint8)
    _merge_planes(codes, lookup, saturated_from, checked / longest, out, is_bound)
    out *= np.float32(1.0 / longest)
    return out, is_bound.astype(np.bool_)

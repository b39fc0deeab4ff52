"""Ratios of interleaved rounds: what a slow moment of the machine does to one side it does to the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Median and quartiles of a sample."""

    median: float
    lower_quartile: float
    upper_quartile: float
    count: int

    def as_dict(self) -> dict[str, float | int]:
        """For JSON."""
        return {
            "median": self.median,
            "lower_quartile": self.lower_quartile,
            "upper_quartile": self.upper_quartile,
            "count": self.count,
        }


def spread(values: Sequence[float]) -> Spread:
    """Median and quartiles (linear interpolation).

    Raises:
        ValueError: there are no values, or one is not finite.
    """
    array = np.asarray(values, np.float64)
    if array.size == 0 or not np.isfinite(array).all():
        raise ValueError(f"expected finite values, found {array.tolist()}")
    low, middle, high = np.quantile(array, (0.25, 0.5, 0.75))
    return Spread(
        median=float(middle), lower_quartile=float(low), upper_quartile=float(high), count=int(array.size)
    )


def ratio_spread(numerators: Sequence[float], denominators: Sequence[float]) -> Spread:
    """Spread of the ratios of each round.

    Args:
        numerators: one per round, > 0.
        denominators: of the same rounds, > 0.

    Raises:
        ValueError: the numbers of rounds differ, there is none, or a value is not positive.
    """
    if len(numerators) != len(denominators):
        raise ValueError(
            f"expected as many rounds on both sides, found {len(numerators)} and {len(denominators)}"
        )
    if min(*numerators, *denominators, 1.0) <= 0.0:
        raise ValueError("expected positive costs in every round")
    return spread([n / d for n, d in zip(numerators, denominators, strict=True)])


def fit_exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Exponent of the power law through the points, by least squares in logarithms: 1 = proportional, 0 = independent.

    Args:
        sizes: > 0, at least two different ones.
        costs: as many, > 0.

    Raises:
        ValueError: the numbers differ, sizes are all the same, or a value is not positive.
    """
    x, y = np.asarray(sizes, np.float64), np.asarray(costs, np.float64)
    if x.shape != y.shape or np.unique(x).size < 2 or min(x.min(), y.min()) <= 0.0:
        raise ValueError(f"expected positive costs at different positive sizes, found {costs} at {sizes}")
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])

"""Median cut of a latitude-longitude map into regions of equal energy (Debevec 2005; Pessoa et al. 2012, section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nearfield_server.radiometry.cube import cube_directions


@dataclass(frozen=True, slots=True, kw_only=True)
class LatLongGrid:
    """Pixels of equal steps in polar angle (rows, from +y) and azimuth (columns).

    Attributes:
        rows: R. columns: 2 R.
        directions: (R 2R, 3) unit, row by row. solid_angles: (R 2R,) exact, they sum to 4 pi.
    """

    rows: int
    columns: int
    directions: NDArray[np.float64]
    solid_angles: NDArray[np.float64]

    @classmethod
    def make(cls, rows: int) -> LatLongGrid:
        """Grid with `rows` rows and twice as many columns."""
        columns = 2 * rows
        polar_edges = np.linspace(0.0, np.pi, rows + 1)
        polar = 0.5 * (polar_edges[1:] + polar_edges[:-1])
        azimuth = (np.arange(columns) + 0.5) * (2.0 * np.pi / columns)
        sine = np.sin(polar)[:, None]
        directions = np.stack(
            np.broadcast_arrays(
                sine * np.cos(azimuth), np.cos(polar)[:, None] * np.ones(columns), sine * np.sin(azimuth)
            ),
            axis=-1,
        )
        rings = (np.cos(polar_edges[:-1]) - np.cos(polar_edges[1:])) * (2.0 * np.pi / columns)
        return cls(
            rows=rows,
            columns=columns,
            directions=directions.reshape(-1, 3),
            solid_angles=np.repeat(rings, columns),
        )

    def cube_pixels(self, resolution: int) -> NDArray[np.int64]:
        """(R 2R,) for every pixel the nearest pixel of a cube map of that resolution."""
        return np.asarray(cKDTree(cube_directions(resolution)).query(self.directions)[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A region as one light: energy-weighted direction (3,), irradiance (3,) sum L dw, solid angle in sr."""

    direction: NDArray[np.float64]
    irradiance: NDArray[np.float64]
    solid_angle: float


def median_cut(grid: LatLongGrid, radiance: NDArray[np.float64], num_regions: int) -> list[Region]:
    """Cut `log2(num_regions)` times; each cut halves the grey energy of every region along its longest side.

    Args:
        grid: of the map.
        radiance: (R 2R, 3).
        num_regions: a power of two.

    Returns:
        The regions that hold light, at most `num_regions`.

    Raises:
        ValueError: `num_regions` is not a power of two.
    """
    if num_regions < 1 or num_regions & (num_regions - 1):
        raise ValueError(f"median cut makes 2^n regions, asked for {num_regions}")
    flux = radiance * grid.solid_angles[:, None]
    grey = flux.mean(axis=1).reshape(grid.rows, grid.columns)
    boxes = [(0, grid.rows, 0, grid.columns)]
    for _ in range(num_regions.bit_length() - 1):
        boxes = [part for box in boxes for part in _halves(grid, grey, box)]
    return [region for box in boxes if (region := _region(grid, flux, grey, box)) is not None]


_Box = tuple[int, int, int, int]


def _halves(grid: LatLongGrid, grey: NDArray[np.float64], box: _Box) -> list[_Box]:
    top, bottom, left, right = box
    height = (bottom - top) * np.pi / grid.rows
    middle = 0.5 * (top + bottom) * np.pi / grid.rows
    # Towards the poles a column is narrower: its width shrinks with the sine of the polar angle.
    width = (right - left) * 2.0 * np.pi / grid.columns * np.sin(middle)
    part = grey[top:bottom, left:right]
    if width >= height and right - left > 1:
        cut = left + _median(part.sum(axis=0))
        return [(top, bottom, left, cut), (top, bottom, cut, right)]
    if bottom - top > 1:
        cut = top + _median(part.sum(axis=1))
        return [(top, cut, left, right), (cut, bottom, left, right)]
    return [box]


def _median(energy: NDArray[np.float64]) -> int:
    """How many of the first lines hold half of the energy: at least one, and not all."""
    cumulative = np.cumsum(energy)
    cut = int(np.argmin(np.abs(cumulative[:-1] - 0.5 * cumulative[-1]))) + 1
    return min(max(cut, 1), len(energy) - 1)


def _region(
    grid: LatLongGrid, flux: NDArray[np.float64], grey: NDArray[np.float64], box: _Box
) -> Region | None:
    top, bottom, left, right = box
    inside = np.arange(grid.rows * grid.columns).reshape(grid.rows, grid.columns)[top:bottom, left:right]
    inside = inside.reshape(-1)
    weight = grey.reshape(-1)[inside]
    mean = weight @ grid.directions[inside]
    length = float(np.linalg.norm(mean))
    if not length > 0.0:
        return None
    return Region(
        direction=mean / length,
        irradiance=flux[inside].sum(axis=0),
        solid_angle=float(grid.solid_angles[inside].sum()),
    )

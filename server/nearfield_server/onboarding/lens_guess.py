"""A first guess at a fish-eye lens from one picture: where the image circle is, and how many pixels a radian takes.

It serves to begin with; a calibration replaces it. The guess is an equidistant lens whose circle ends at a field of view that the user
knows from the data sheet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.models import FisheyeIntrinsics

DEFAULT_FIELD_DEGREES = 180.0
_SIDE = 512
_ANGLES = 720
_TRIPLES = 600
_LEAST_ARC = 0.25
"""Share of the directions around the centre in which the rim of the circle must be seen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageCircle:
    """Where a fish-eye picture holds light: centre and radius in pixels (centre of the top-left pixel = 0)."""

    x: float
    y: float
    radius: float


def find_image_circle(brightness: NDArray[Any]) -> ImageCircle | None:
    """Find the image circle of a fish-eye lens; parts of it may be dark or lie outside the picture.

    Args:
        brightness: (H, W) linear signal of one picture, any unit.

    Returns:
        The circle; None where the picture has no rim to be seen (it is dark, or lit into its corners).
    """
    height, width = brightness.shape
    scale = max(1.0, max(height, width) / _SIDE)
    size = (max(1, round(width / scale)), max(1, round(height / scale)))
    small: Any = cv2.resize(np.asarray(brightness, np.float32), size, interpolation=cv2.INTER_AREA)
    mask = _lit(small)
    if mask is None:
        return None
    found = _fit_circle(_rim(mask), small.shape)
    if found is None:
        return None
    x, y, radius = found
    ratio_x, ratio_y = width / size[0], height / size[1]
    return ImageCircle(
        x=(x + 0.5) * ratio_x - 0.5, y=(y + 0.5) * ratio_y - 0.5, radius=radius * math.sqrt(ratio_x * ratio_y)
    )


def guess_lens(
    brightness: NDArray[Any], field_degrees: float = DEFAULT_FIELD_DEGREES
) -> tuple[FisheyeIntrinsics, bool]:
    """Guess an equidistant lens.

    Args:
        brightness: (H, W) linear signal of one picture.
        field_degrees: full angle that the image circle shows.

    Returns:
        The lens, and whether the image circle was found. If it was not, the lens shows that angle over the width of the picture.
    """
    height, width = brightness.shape
    circle = find_image_circle(brightness)
    if circle is None:
        return default_lens(width, height, field_degrees), False
    theta_max = math.radians(field_degrees) / 2
    focal = circle.radius / theta_max
    return (
        FisheyeIntrinsics(
            width=width,
            height=height,
            fx=focal,
            fy=focal,
            cx=circle.x,
            cy=circle.y,
            k=(0.0, 0.0, 0.0, 0.0),
            theta_max=theta_max,
        ),
        True,
    )


def with_field(lens: FisheyeIntrinsics, field_degrees: float) -> FisheyeIntrinsics:
    """The same image circle of a lens that shows another full angle."""
    theta_max = math.radians(field_degrees) / 2
    scale = lens.theta_max / theta_max
    return replace(lens, fx=lens.fx * scale, fy=lens.fy * scale, theta_max=theta_max)


def default_lens(width: int, height: int, field_degrees: float = DEFAULT_FIELD_DEGREES) -> FisheyeIntrinsics:
    """An equidistant lens in the middle of the picture that shows `field_degrees` over its width."""
    theta_max = math.radians(field_degrees) / 2
    focal = width / 2 / theta_max
    return FisheyeIntrinsics(
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=(width - 1) / 2,
        cy=(height - 1) / 2,
        k=(0.0, 0.0, 0.0, 0.0),
        theta_max=theta_max,
    )


def _lit(small: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """Pixels that are brighter than the corners; None if there is no such difference."""
    height, width = small.shape
    patch = max(2, min(height, width) // 24)
    corners = np.concatenate(
        [
            small[rows, columns].ravel()
            for rows in (np.s_[:patch], np.s_[-patch:])
            for columns in (np.s_[:patch], np.s_[-patch:])
        ]
    )
    floor = float(np.median(corners))
    noise = 1.4826 * float(np.median(np.abs(corners - floor)))
    bright = float(np.percentile(small, 90)) - floor
    step = max(8.0 * noise, 0.01 * bright)
    if bright <= 0 or bright <= 2.0 * step:
        return None
    mask: Any = (small > floor + step).astype(np.uint8)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(mask)
    areas = statistics[1:, cv2.CC_STAT_AREA]
    # Stray light and noise outside the circle are small; walls divided by dark furniture are not.
    large = 1 + np.flatnonzero(areas >= 0.02 * mask.size)
    kept: NDArray[np.bool_] = np.isin(labels, large)
    return kept if kept.any() else None


def _rim(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(N, 2) outermost lit points, x and y, around the centre of the lit area; points at the border of the picture are left out."""
    height, width = mask.shape
    rows, columns = np.nonzero(mask)
    centre_x, centre_y = columns.mean(), rows.mean()
    angle = np.arctan2(rows - centre_y, columns - centre_x)
    sector = ((angle / (2 * np.pi) + 0.5) * _ANGLES).astype(int) % _ANGLES
    distance = np.hypot(rows - centre_y, columns - centre_x)
    order = np.lexsort((distance, sector))
    last = np.flatnonzero(np.diff(sector[order], append=-1))
    x, y = columns[order[last]], rows[order[last]]
    inside = (x > 1) & (x < width - 2) & (y > 1) & (y < height - 2)
    return np.stack([x[inside], y[inside]], axis=-1).astype(np.float64)


def _fit_circle(points: NDArray[np.float64], shape: tuple[int, ...]) -> tuple[float, float, float] | None:
    """Circle through most of the rim that leaves hardly any lit point outside: dark walls push the rim in, nothing pushes it out."""
    if len(points) < _LEAST_ARC * _ANGLES:
        return None
    rng = np.random.default_rng(1)
    best, best_score = None, 0.0
    longest = math.hypot(*shape)
    for _ in range(_TRIPLES):
        circle = _algebraic_circle(points[rng.choice(len(points), 3, replace=False)])
        if circle is None or not 0.1 * longest < circle[2] < longest:
            continue
        gap = np.hypot(points[:, 0] - circle[0], points[:, 1] - circle[1]) - circle[2]
        tolerance = max(1.0, 0.006 * circle[2])
        score = np.count_nonzero(np.abs(gap) <= tolerance) - 3.0 * np.count_nonzero(gap > tolerance)
        if score > best_score:
            best, best_score = circle, float(score)
    if best is None:
        return None
    for _ in range(5):
        gap = np.abs(np.hypot(points[:, 0] - best[0], points[:, 1] - best[1]) - best[2])
        near = points[gap <= max(1.0, 0.006 * best[2])]
        refined = _algebraic_circle(near) if len(near) >= _LEAST_ARC * _ANGLES else None
        if refined is None:
            return None
        best = refined
    # The rim runs half a pixel outside the centres of its pixels.
    return best[0], best[1], best[2] + 0.5


def _algebraic_circle(points: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """Least squares of x^2 + y^2 = 2 a x + 2 b y + c (Kasa); None for points on a line."""
    middle = points.mean(axis=0)
    local = points - middle
    system = np.column_stack([2.0 * local, np.ones(len(local))])
    solution, _, rank, _ = np.linalg.lstsq(system, (local**2).sum(axis=1), rcond=1e-9)
    square = solution[2] + solution[0] ** 2 + solution[1] ** 2
    if rank < 3 or square <= 0:
        return None
    return float(solution[0] + middle[0]), float(solution[1] + middle[1]), float(math.sqrt(square))

"""k-means of the samples in position and normal, with steady slots (Rohmer et al. 2014, section 4.3; Dong et al. 2009).

Cluster space is (position, NORMAL_SCALE * normal), see `blocks.cluster_features`.

Differs from the paper: centres start where the last update left them and stay there unless moving them pays; slots keep
their light and carry a generation; slots without light move to where they help most.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

_MIN_SEPARATION: Final = 1e-4
"""Metres of cluster space: a sample this close to a centre does not need one of its own."""
_CONVERGED: Final = 1e-4
"""Metres: Lloyd's iteration ends when no centre moves further."""
_STICKY_GAIN: Final = 0.02
"""Centres stay where they were unless the mean squared distance falls by more than this share."""
_RELOCATION_GAIN: Final = 2.0
"""A slot is moved to another place when the gain there is this many times the loss here."""
_JUMP: Final = 0.25
"""Metres: a centre that moves further in one update is another light."""
_CANDIDATES: Final = 8
_POINTS_AT_ONCE: Final = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterState:
    """Slots between updates.

    Attributes:
        centres: (M, 6) float64 in cluster space. alive: (M,) bool, the slot holds a light.
        generation: (M,) uint8, changes when a slot is given to another light.
    """

    centres: NDArray[np.float64]
    alive: NDArray[np.bool_]
    generation: NDArray[np.uint8]


def empty_state(num_slots: int) -> ClusterState:
    """All slots without a light."""
    return ClusterState(
        centres=np.zeros((num_slots, 6)),
        alive=np.zeros(num_slots, dtype=np.bool_),
        generation=np.zeros(num_slots, dtype=np.uint8),
    )


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _distances(columns: Any, first: int, count: int, centre: Any, distance: Any) -> None:
    """Squared distances of some points to a centre. Unsigned indices: signed ones are tested, and not vectorised."""
    c0, c1, c2, c3, c4, c5 = centre[0], centre[1], centre[2], centre[3], centre[4], centre[5]
    for k in range(np.uintp(count)):
        point = np.uintp(first) + k
        total = (columns[0, point] - c0) * (columns[0, point] - c0)
        total += (columns[1, point] - c1) * (columns[1, point] - c1)
        total += (columns[2, point] - c2) * (columns[2, point] - c2)
        total += (columns[3, point] - c3) * (columns[3, point] - c3)
        total += (columns[4, point] - c4) * (columns[4, point] - c4)
        total += (columns[5, point] - c5) * (columns[5, point] - c5)
        distance[k] = total


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _assign(columns: Any, centres: Any, alive: Any, label: Any, nearest: Any, second: Any) -> float:
    """Nearest living centre of each point, squared distances to the nearest and second nearest; returns their mean.

    `columns` (6, S): one axis after the other, and a few points at a time, so that the loops over points run in vectors.
    """
    num_points = columns.shape[1]
    distance = np.empty(_POINTS_AT_ONCE)
    best, runner_up, owner = np.empty_like(distance), np.empty_like(distance), np.empty_like(distance)
    distance[:] = np.inf
    total = 0.0
    for first in range(0, num_points, _POINTS_AT_ONCE):
        count = min(_POINTS_AT_ONCE, num_points - first)
        best[:] = np.inf
        runner_up[:] = np.inf
        owner[:] = -1.0
        for slot in range(centres.shape[0]):
            if not alive[slot]:
                continue
            _distances(columns, first, count, centres[slot], distance)
            for k in range(np.uintp(_POINTS_AT_ONCE)):
                other = distance[k] if distance[k] > best[k] else best[k]
                runner_up[k] = other if other < runner_up[k] else runner_up[k]
                owner[k] = np.float64(slot) if distance[k] < best[k] else owner[k]
                best[k] = distance[k] if distance[k] < best[k] else best[k]
        for k in range(count):
            label[first + k], nearest[first + k], second[first + k] = (
                np.int64(owner[k]),
                best[k],
                runner_up[k],
            )
            total += best[k]
    return float(total / num_points)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _move_to_means(points: Any, label: Any, centres: Any, alive: Any) -> float:
    """Move centres to the means of their points; a slot without points dies. Returns the largest squared movement."""
    num_slots = centres.shape[0]
    total = np.zeros((num_slots, 6))
    count = np.zeros(num_slots)
    for k in range(points.shape[0]):
        count[label[k]] += 1.0
        for axis in range(6):
            total[label[k], axis] += points[k, axis]
    largest = 0.0
    for slot in range(num_slots):
        if not alive[slot]:
            continue
        if count[slot] == 0.0:
            alive[slot] = False
            continue
        movement = 0.0
        for axis in range(6):
            mean = total[slot, axis] / count[slot]
            movement += (mean - centres[slot, axis]) ** 2
            centres[slot, axis] = mean
        largest = max(largest, movement)
    return largest


class _Work:
    """Buffers and the points of one update."""

    def __init__(self, points: NDArray[np.float64], state: ClusterState) -> None:
        self.points = points
        self.columns = np.ascontiguousarray(points.T)
        self.centres = state.centres.copy()
        self.alive = state.alive.copy()
        self.generation = state.generation.copy()
        self.label = np.empty(points.shape[0], dtype=np.int64)
        self.nearest = np.empty(points.shape[0])
        self.second = np.empty(points.shape[0])

    def assign(self) -> float:
        return float(_assign(self.columns, self.centres, self.alive, self.label, self.nearest, self.second))

    def lloyd(self, iterations: int) -> float:
        for _ in range(iterations):
            moved = _move_to_means(self.points, self.label, self.centres, self.alive)
            self.assign()
            if moved < _CONVERGED * _CONVERGED:
                break
        return float(self.nearest.mean())

    def place(self, slot: int, sample: int) -> None:
        """Give a slot to the light at a sample."""
        self.centres[slot] = self.points[sample]
        self.alive[slot] = True
        self.generation[slot] = (int(self.generation[slot]) + 1) & 255
        distance = np.sum((self.points - self.centres[slot]) ** 2, axis=1)
        closer = distance < self.nearest
        self.second = np.where(closer, self.nearest, np.minimum(self.second, distance))
        self.nearest = np.where(closer, distance, self.nearest)
        self.label[closer] = slot

    def seed_dead_slots(self) -> None:
        """Give slots without light to the worst-served samples (greedy k-means++ on fixed quantiles)."""
        for slot in np.flatnonzero(~self.alive):
            sample = self.worst_served(np.ones(self.points.shape[0], dtype=np.bool_))
            if sample < 0:
                return
            self.place(int(slot), sample)

    def worst_served(self, among: NDArray[np.bool_]) -> int:
        """Of a few candidates with probability ~ squared distance, the sample whose centre would help most; or -1."""
        if not np.isfinite(self.nearest).all():
            return int(np.flatnonzero(~np.isfinite(self.nearest))[0])
        badness = np.where(among & (self.nearest > _MIN_SEPARATION**2), self.nearest, 0.0)
        cumulative = np.cumsum(badness)
        if not cumulative[-1] > 0.0:
            return -1
        quantiles = (np.arange(_CANDIDATES) + 0.5) / _CANDIDATES * cumulative[-1]
        candidates = np.unique(np.searchsorted(cumulative, quantiles))
        distance = np.sum((self.points[candidates, None] - self.points[None]) ** 2, axis=2)
        return int(candidates[np.argmin(np.minimum(distance, self.nearest).sum(axis=1))])

    def relocate(self, iterations: int) -> None:
        """Move slots that hardly help to clusters that need splitting, while the gain is clear."""
        num_slots = self.alive.shape[0]
        for _ in range(num_slots):
            loss = np.bincount(self.label, weights=self.second - self.nearest, minlength=num_slots)
            loss[~self.alive] = np.inf
            need = np.bincount(self.label, weights=self.nearest, minlength=num_slots)
            slot = int(np.argmin(loss))
            need[slot] = 0.0
            # Splitting the cluster in two removes half of its squared distance or more.
            crowded = int(np.argmax(need))
            if not 0.5 * need[crowded] > _RELOCATION_GAIN * loss[slot]:
                return
            sample = self.worst_served(self.label == crowded)
            if sample < 0:
                return
            before = float(self.nearest.mean())
            saved = (self.centres.copy(), self.alive.copy(), self.generation.copy())
            self.centres[slot] = self.points[sample]
            self.generation[slot] = (int(self.generation[slot]) + 1) & 255
            self.assign()
            if self.lloyd(iterations) >= before:
                self.centres, self.alive, self.generation = saved
                self.assign()
                return


def update_clusters(state: ClusterState, points: NDArray[np.float64], iterations: int) -> ClusterState:
    """Fit the slots to new samples of equal energy.

    Args:
        state: of the previous update, or `empty_state`.
        points: (S, 6) float64 finite points of cluster space, energy-weighted by their density.
        iterations: upper bound of Lloyd's iterations.

    Returns:
        The new state. Without samples all slots are dead. With fewer distinct points than slots some slots stay dead.
        For unchanged points the centres do not move.
    """
    if points.shape[0] == 0:
        return ClusterState(
            centres=state.centres, alive=np.zeros_like(state.alive), generation=state.generation
        )
    work = _Work(points, state)
    kept = np.inf
    if state.alive.any():
        kept = work.assign()
        used = np.zeros_like(state.alive)
        used[work.label] = True
        if not used[work.alive].all():
            work.alive &= used
            work.assign()
    else:
        work.nearest[:] = np.inf
        work.second[:] = np.inf
    work.seed_dead_slots()
    reseeded = not np.array_equal(work.alive, state.alive) or not np.array_equal(
        work.generation, state.generation
    )
    if reseeded:
        work.assign()
    # Slots that lost their last sample on the way are given out again, once.
    moved = work.lloyd(iterations)
    if work.alive.sum() < state.alive.shape[0]:
        work.seed_dead_slots()
        work.assign()
        moved = work.lloyd(iterations)
    generation = work.generation.copy()
    work.relocate(iterations)
    moved = float(work.nearest.mean())
    relocated = not np.array_equal(generation, work.generation)
    if not reseeded and not relocated and kept <= (1.0 + _STICKY_GAIN) * moved + _MIN_SEPARATION**2:
        return state
    same = work.alive & state.alive & (work.generation == state.generation)
    jumped = same & (np.linalg.norm(work.centres[:, :3] - state.centres[:, :3], axis=1) > _JUMP)
    work.generation[jumped] += np.uint8(1)
    return ClusterState(centres=work.centres, alive=work.alive, generation=work.generation)

import numpy as np
import pytest

from nearfield_server.pipeline.blocks import NORMAL_SCALE, cluster_features
from nearfield_server.pipeline.clustering import ClusterState, empty_state, update_clusters


def _lamp(centre: tuple[float, float, float], half: float, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    position = np.array(centre) + rng.uniform(-half, half, (count, 3)) * [1.0, 0.0, 1.0]
    return cluster_features(position, np.broadcast_to([0.0, -1.0, 0.0], position.shape))


def _cost(state: ClusterState, points: np.ndarray) -> float:
    centres = state.centres[state.alive]
    return float(np.min(np.sum((points[:, None] - centres[None]) ** 2, axis=2), axis=1).mean())


def _fit(points: np.ndarray, slots: int = 8) -> ClusterState:
    return update_clusters(empty_state(slots), points, 20)


def test_distance_counts_normals_as_stated() -> None:
    first = cluster_features(np.zeros(3), np.array([0.0, 1.0, 0.0]))
    second = cluster_features(np.array([0.3, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    assert ((first - second) ** 2).sum() == pytest.approx(0.09 + NORMAL_SCALE**2 * 2.0)


def test_unchanged_samples_leave_the_state_alone() -> None:
    points = np.concatenate([_lamp((1, 3, 1), 0.3, 2000), _lamp((4, 3, 2), 0.5, 2000, 1)])
    state = _fit(points)
    again = update_clusters(state, points, 20)
    np.testing.assert_array_equal(again.centres, state.centres)
    np.testing.assert_array_equal(again.generation, state.generation)


def test_result_is_a_fixed_point_about_as_good_as_the_best_of_many_starts() -> None:
    points = np.concatenate([_lamp((k, 3, k % 3), 0.2, 500, k) for k in range(5)])
    state = _fit(points)
    assert state.alive.all()
    label = np.argmin(np.sum((points[:, None] - state.centres[None]) ** 2, axis=2), axis=1)
    means = np.stack([points[label == k].mean(axis=0) for k in range(8)])
    np.testing.assert_allclose(state.centres, means, atol=5e-3)
    best = min(_cost(_random_start(points, seed), points) for seed in range(20))
    assert _cost(state, points) <= 1.15 * best


def _random_start(points: np.ndarray, seed: int) -> ClusterState:
    chosen = np.random.default_rng(seed).choice(points.shape[0], 8, replace=False)
    centres = points[chosen].copy()
    for _ in range(50):
        label = np.argmin(np.sum((points[:, None] - centres[None]) ** 2, axis=2), axis=1)
        for k in range(8):
            if (label == k).any():
                centres[k] = points[label == k].mean(axis=0)
    return ClusterState(centres=centres, alive=np.ones(8, dtype=bool), generation=np.zeros(8, dtype=np.uint8))


def test_every_lamp_gets_a_slot() -> None:
    lamps = [(0.5, 3, 0.5), (5.5, 3, 0.5), (0.5, 3, 3.5), (5.5, 3, 3.5)]
    points = np.concatenate([_lamp(lamp, 0.1, 20 + 2000 * (k == 0), k) for k, lamp in enumerate(lamps)])
    state = _fit(points)
    for lamp in lamps:
        assert np.linalg.norm(state.centres[:, :3] - lamp, axis=1).min() < 0.1


def test_a_slot_keeps_its_light_when_another_appears() -> None:
    first = _lamp((1, 3, 1), 0.4, 4000)
    state = _fit(first)
    both = np.concatenate([first[::2], _lamp((5, 3, 3), 0.4, 2000, 1)])
    after = update_clusters(state, both, 20)
    near_new = np.linalg.norm(after.centres[:, :3] - [5, 3, 3], axis=1) < 1.0
    assert 2 <= near_new.sum() <= 6
    kept = after.generation == state.generation
    assert kept.sum() >= 2
    assert (after.generation[near_new] != state.generation[near_new]).all()
    assert (np.linalg.norm(after.centres[kept, :3] - state.centres[kept, :3], axis=1) < 0.3).all()
    # And nothing goes back and forth from then on.
    settled = update_clusters(after, both, 20)
    np.testing.assert_array_equal(settled.generation, after.generation)


def test_switching_to_another_lamp_renews_every_slot() -> None:
    state = _fit(_lamp((1, 3, 1), 0.4, 1000))
    after = update_clusters(state, _lamp((5, 3, 3), 0.4, 1000, 1), 20)
    assert after.alive.all()
    assert (np.linalg.norm(after.centres[:, :3] - [5, 3, 3], axis=1) < 1.0).all()
    assert (after.generation != state.generation).all()


def test_dark_and_back() -> None:
    points = _lamp((1, 3, 1), 0.4, 1000)
    state = _fit(points)
    dark = update_clusters(state, np.zeros((0, 6)), 20)
    assert not dark.alive.any()
    back = update_clusters(dark, points, 20)
    assert back.alive.all()
    assert (back.generation != state.generation).all()


def test_a_moving_lamp_keeps_its_slots() -> None:
    points = _lamp((1, 3, 1), 0.3, 2000)
    state = _fit(points)
    for step in range(1, 11):
        moved = points + np.array([0.05 * step, 0, 0, 0, 0, 0])
        after = update_clusters(state, moved, 20)
        np.testing.assert_array_equal(after.generation, state.generation)
        state = after
    assert np.linalg.norm(state.centres[:, :3].mean(axis=0) - [1.5, 3, 1]) < 0.05


def test_generation_wraps() -> None:
    state = ClusterState(
        centres=np.zeros((4, 6)), alive=np.zeros(4, dtype=bool), generation=np.full(4, 255, dtype=np.uint8)
    )
    after = update_clusters(state, _lamp((1, 3, 1), 0.4, 100), 20)
    np.testing.assert_array_equal(after.generation, 0)


@pytest.mark.parametrize("slots", [8, 16, 64])
@pytest.mark.parametrize("distinct", [1, 2, 5])
def test_fewer_points_than_slots(slots: int, distinct: int) -> None:
    points = np.repeat(_lamp((1, 3, 1), 1.0, distinct), 400, axis=0)
    state = _fit(points, slots)
    assert state.alive.sum() == distinct
    assert np.isfinite(state.centres).all()
    assert _cost(state, points) == pytest.approx(0.0, abs=1e-12)


def test_far_from_the_origin() -> None:
    points = np.concatenate([_lamp((1, 3, 1), 0.3, 500), _lamp((4, 3, 2), 0.5, 500, 1)])
    shift = np.array([4096.0, -2048.0, 1024.0, 0, 0, 0])
    near, far = _fit(points), _fit(points + shift)
    np.testing.assert_allclose(far.centres - shift, near.centres, atol=1e-6)

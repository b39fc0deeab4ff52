"""Pictures of several cameras that belong together: nearest in time, never backwards, and nobody waits for long."""

from __future__ import annotations

import heapq
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.illumination.frames import FrameCollector, camera_report
from nearfield_server.illumination.pairing import Picture, choose_pictures
from nearfield_server.pipeline.frame_tracker import FrameTracker

MS = 1_000_000
PERIOD = 100 * MS


def _taken(*times_ms: float) -> list[Picture]:
    return [
        Picture(number, round(time_ms * MS), round(time_ms * MS))
        for number, time_ms in enumerate(times_ms, 1)
    ]


def _chosen_ms(pictures: list[list[Picture]], used: list[int] | None = None) -> list[float | None]:
    found = choose_pictures(pictures, used or [0] * len(pictures), PERIOD)
    return [None if picture is None else picture.from_ns / MS for picture in found.chosen]


def test_nobody_there() -> None:
    found = choose_pictures([[], []], [0, 0], PERIOD)
    assert found.chosen == (None, None)
    assert not found.is_holding


def test_a_picture_waits_for_its_partner_but_not_longer_than_one_period() -> None:
    assert _chosen_ms([_taken(0, 100), _taken(0)]) == [0, 0]
    assert _chosen_ms([_taken(0, 100), _taken(0, 98)]) == [100, 98]
    # The other one has missed a whole period: on without it.
    assert _chosen_ms([_taken(0, 100, 200), _taken(0)]) == [200, 0]


def test_free_running_cameras_are_paired_with_their_nearest_pictures() -> None:
    found = choose_pictures([_taken(0, 100, 200), _taken(30, 130)], [0, 0], PERIOD)
    assert [picture.from_ns // MS for picture in found.chosen if picture] == [100, 130]
    assert found.spread_ns == 30 * MS
    assert found.is_holding
    assert _chosen_ms([_taken(0, 100, 200), _taken(30, 130, 230)]) == [200, 230]


def test_a_still_picture_holds_as_long_as_its_camera_says_so() -> None:
    still = Picture(1, 0, 1000 * MS)
    found = choose_pictures([[still], _taken(900, 1000)], [0, 0], PERIOD)
    assert (found.spread_ns, found.is_holding) == (0, False)
    assert found.chosen == (still, Picture(2, 1000 * MS, 1000 * MS))


def test_pictures_never_go_back() -> None:
    assert _chosen_ms([_taken(0, 100), _taken(0)], used=[2, 1]) == [100, 0]


times = st.lists(st.integers(0, 20), min_size=0, max_size=4, unique=True).map(sorted)


@settings(max_examples=200, deadline=None)
@given(st.lists(times, min_size=1, max_size=4), st.lists(st.integers(0, 4), min_size=4, max_size=4))
def test_the_choice_is_the_best_of_all_choices(taken: list[list[int]], used: list[int]) -> None:
    """Against a search through all sets: every present camera as near as it can be to the newest moment that all have seen."""
    pictures = [_taken(*(20.0 * time for time in each)) for each in taken]
    used = [min(least, len(held)) for least, held in zip(used, pictures, strict=False)]
    found = choose_pictures(pictures, used, PERIOD)
    newest = [held[-1].from_ns for held in pictures if held]
    for held, picture, present, least in zip(pictures, found.chosen, found.present, used, strict=True):
        assert (picture is None) == (not held)
        if picture is None:
            continue
        assert picture.sequence >= least
        assert present == (held[-1].from_ns >= max(newest) - 1.5 * PERIOD)
        if not present:
            assert picture is held[-1]
            continue
        moment = min(time for time in newest if time >= max(newest) - 1.5 * PERIOD)
        usable = [other for other in held if other.sequence >= least]
        assert abs(picture.from_ns - moment) == min(abs(other.from_ns - moment) for other in usable)


class Rings:
    """Cameras that write into rings at simulated times, and their reader."""

    def __init__(self, count: int, slots: int = 4) -> None:
        self.fds = [create_ring(f"cam{index}", RingShape(4, 4, slots)) for index in range(count)]
        self.writers = [FrameRingWriter(fd, "w") for fd in self.fds]
        self.now_ns = 1
        self.collector = FrameCollector(
            [FrameRingReader(fd, "r") for fd in self.fds], PERIOD * 1e-9, clock=lambda: self.now_ns
        )
        self._revisions = [0] * count

    def write(self, camera: int, time_ns: int) -> None:
        self._revisions[camera] += 1
        with self.writers[camera].write(self._revisions[camera], time_ns) as draft:
            draft.pixels[...] = self._revisions[camera]
            draft.counters[...] = 0

    def close(self) -> None:
        for fd in self.fds:
            os.close(fd)


def _simulate(
    seed: int, *, cameras: int, latency_ms: float, lost: float
) -> list[tuple[int, list[int], list[int], float]]:
    """(now, capture times in use, newest capture times, spread) at every arrival of free-running cameras with clocks of their own."""
    rng = np.random.default_rng(seed)
    rings = Rings(cameras)
    events: list[tuple[float, int, float]] = []
    for camera in range(cameras):
        taken = rng.uniform(0, 100) + np.arange(1, 60) * 100.0 * (1 + rng.uniform(-1e-3, 1e-3))
        for time_ms in taken[rng.random(taken.size) >= lost]:
            heapq.heappush(events, (time_ms + rng.uniform(1, latency_ms), camera, time_ms))
    steps = []
    newest = [0] * cameras
    while events:
        arrival_ms, camera, time_ms = heapq.heappop(events)
        rings.now_ns = round(arrival_ms * MS)
        rings.write(camera, round(time_ms * MS))
        newest[camera] = max(newest[camera], round(time_ms * MS))
        frames = rings.collector.collect()
        assert rings.collector.stayed_whole()
        in_use = [0 if frame is None else frame.timestamp_ns for frame in frames]
        steps.append((rings.now_ns, in_use, list(newest), rings.collector.pictures.spread_ns / MS))
    rings.close()
    return steps


def test_cameras_with_clocks_of_their_own_stay_within_half_a_period() -> None:
    for seed in range(5):
        for cameras, widest_ms in (
            (2, 50.1),
            (3, 100.1),
        ):  # of three, two may lie on either side of the third
            steps = _simulate(seed, cameras=cameras, latency_ms=40, lost=0.0)
            # At the start there is nothing to choose from.
            assert max(spread for now_ns, _, _, spread in steps if now_ns > 400 * MS) <= widest_ms


def test_with_lost_pictures_no_camera_goes_back_and_none_waits_longer_than_a_period() -> None:
    for seed in range(5):
        steps = _simulate(seed, cameras=3, latency_ms=90, lost=0.3)
        waiting_since = [0, 0, 0]
        before = ([0, 0, 0], [0, 0, 0])
        for now_ns, in_use, newest, _ in steps:
            for camera in range(3):
                assert in_use[camera] >= before[0][camera]
                if newest[camera] != before[1][camera]:
                    waiting_since[camera] = now_ns
                if in_use[camera] != newest[camera]:
                    assert now_ns - waiting_since[camera] <= PERIOD
            before = (in_use, newest)


def test_cameras_that_stop_all_together_leave_no_picture_unused() -> None:
    rings = Rings(2)
    for time_ms in (100, 200):
        rings.write(0, time_ms * MS)
        rings.write(1, time_ms * MS)
    rings.write(0, 300 * MS)
    rings.now_ns = 305 * MS
    assert [frame.timestamp_ns // MS for frame in rings.collector.collect() if frame] == [200, 200]
    assert rings.collector.pictures.is_holding
    rings.now_ns = 406 * MS
    assert [frame.timestamp_ns // MS for frame in rings.collector.collect() if frame] == [300, 200]
    assert not rings.collector.pictures.is_holding
    # And it stays so: time does not run backwards.
    assert [frame.timestamp_ns // MS for frame in rings.collector.collect() if frame] == [300, 200]
    rings.close()


@pytest.mark.parametrize("slots", [2, 3, 4])
def test_an_older_picture_is_whole_and_its_tiles_are_those_of_its_time(slots: int) -> None:
    rings = Rings(2, slots)
    rings.write(0, 100 * MS)
    rings.write(1, 100 * MS)
    rings.collector.collect()
    rings.write(0, 200 * MS)
    first, _ = rings.collector.collect()
    assert first is not None
    assert first.timestamp_ns == 100 * MS
    assert (first.pixels == 1).all()
    assert (first.tile_revisions == first.content_revision).all()
    rings.write(1, 200 * MS)
    later, _ = rings.collector.collect()
    assert later is not None
    assert (later.pixels == 2).all()
    assert (later.tile_revisions != first.tile_revisions).all()
    assert rings.collector.stayed_whole()
    rings.close()


def test_copies_are_chosen_as_views_are() -> None:
    rings = Rings(2)
    for _ in range(6):
        rings.write(0, 100 * MS)
    rings.write(1, 100 * MS)
    rings.collector.collect()
    for _ in range(6):
        rings.write(0, 110 * MS)
    assert not rings.collector.stayed_whole()
    rings.collector.recollect()
    rings.write(0, 210 * MS)
    first, second = rings.collector.collect()
    assert first is not None
    assert second is not None
    assert (first.timestamp_ns, second.timestamp_ns) == (110 * MS, 100 * MS)
    assert (first.pixels == 12).all()
    rings.close()


def test_tiles_that_are_not_told_to_have_changed_are_those_used_before() -> None:
    """Older pictures, skipped ones, copies and torn ones included: what was gathered of a tile holds until its revision changes."""
    rng = np.random.default_rng(11)
    shape = RingShape(64, 96, 4)
    fds = [create_ring(f"cam{index}", shape) for index in range(2)]
    writers = [FrameRingWriter(fd, "w") for fd in fds]
    now = [10 * MS]
    collector = FrameCollector([FrameRingReader(fd, "r") for fd in fds], PERIOD * 1e-9, clock=lambda: now[0])
    tracker = FrameTracker(((64, 96), (64, 96)))
    gathered: list[np.ndarray | None] = [None, None]
    revisions, older, kept = [0, 0], 0, 0

    def expose(camera: int) -> None:
        revisions[camera] += 1
        with writers[camera].write(revisions[camera], now[0] - int(rng.integers(1, 60)) * MS) as draft:
            draft.counters[...] = 0
            draft.pixels[...] = 0 if draft.previous is None else draft.previous
            if draft.previous is not None:
                draft.changed[...] = rng.random(draft.changed.shape) < 0.3
            for row, column in np.argwhere(draft.changed):
                tile = np.s_[32 * row : 32 * row + 32, 32 * column : 32 * column + 32]
                draft.pixels[tile] = rng.integers(1, 2000)

    for _ in range(1500):
        now[0] += int(rng.integers(5, 60)) * MS
        for camera in range(2):
            if rng.random() < 0.4:
                expose(camera)
        if rng.random() < 0.3:
            continue
        frames = collector.collect()
        if rng.random() < 0.02:
            for _ in range(4):
                expose(0)
        while True:
            tracker.take(frames)
            changed = tracker.changed_tiles()
            tracker.mark_gathered()
            seen = [None if frame is None else frame.pixels.copy() for frame in frames]
            is_whole = collector.stayed_whole()
            for camera, (frame, pixels, before) in enumerate(zip(frames, seen, gathered, strict=True)):
                if frame is None or pixels is None:
                    continue
                older += frame.sequence < collector.readers[camera].newest_sequence
                if is_whole and before is not None and changed is not None:
                    differs = (pixels != before).any(-1).reshape(2, 32, 3, 32).any((1, 3))
                    assert not (differs & ~changed[camera]).any()
                    kept += int((~changed[camera]).sum())
            gathered = seen
            if is_whole:
                break
            frames = collector.recollect()
    assert older > 50
    assert kept > 1000
    for fd in fds:
        os.close(fd)


def test_the_report_tells_what_is_in_use() -> None:
    rings = Rings(2)
    rings.write(0, 1000 * MS)
    rings.writers[0].confirm(1900 * MS)
    rings.write(1, 500 * MS)
    rings.collector.collect()
    left, right = camera_report(
        rings.collector.readers, ["left", "right"], 2000 * MS, 1.0, rings.collector.pictures
    )
    assert (left["age_s"], left["picture_age_s"], left["paired"], left["stale"]) == (0.1, 1.0, True, False)
    assert (right["age_s"], right["picture_age_s"], right["paired"], right["stale"]) == (
        1.5,
        1.5,
        False,
        True,
    )
    rings.close()

"""Brackets of exposures of a real GigE Vision device: whatever the method, the merged picture is the room."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cameras.harness import FULL_WELL_RADIANCE, CameraProcess
from tests.network_namespace import camera_address
from tests.service.harness import PATIENCE_S, TINY_ROOM

from nearfield_server.capture.cameras import SourcePlan, build_source
from nearfield_server.capture.source import RawFrame
from nearfield_server.scene.device_schema import AravisSourceTable
from nearfield_server.scene.room_config import load_room
from nearfield_server.virtual_camera.scenery import Scenery

pytestmark = pytest.mark.cameras

SIDE = 128
ADDRESS = camera_address(130)


@pytest.fixture(scope="module")
def camera() -> Iterator[CameraProcess]:
    running = CameraProcess(TINY_ROOM, "0", ADDRESS).ready()
    yield running
    running.close()


@pytest.fixture(scope="module")
def room() -> NDArray[np.float64]:
    """(H, W, 3) radiance that the camera looks at."""
    return Scenery(load_room(TINY_ROOM), "0").radiance((1.0, 1.0)).astype(np.float64)


def merged_pictures(count: int, **hdr: Any) -> tuple[list[RawFrame], dict[str, Any]]:
    """The first pictures of a source, their pixels copied, and what it says of itself."""
    table = AravisSourceTable.model_validate(
        {
            "kind": "aravis",
            "address": ADDRESS,
            "pixel_format": "BayerRG12",
            "radiance_per_code": FULL_WELL_RADIANCE,
            "hdr": {"mode": "bracket", **hdr},
        }
    )
    source = build_source(
        SourcePlan(camera_id="cam0", camera_index=0, config=table, height=SIDE, width=SIDE, frame_rate=20.0)
    )
    stop = threading.Event()
    frames: list[RawFrame] = []
    end_s = time.monotonic() + PATIENCE_S
    source.open()
    try:
        while len(frames) < count:
            assert time.monotonic() < end_s, source.describe()
            source.wait_for_frame(stop, 0.05)
            frame = source.next_frame(time.monotonic_ns())
            if frame is not None:
                frames.append(
                    RawFrame(
                        pixels=frame.pixels.copy(),
                        timestamp_ns=frame.timestamp_ns,
                        content_revision=frame.content_revision,
                        counters=frame.counters,
                        metadata=frame.metadata,
                    )
                )
        return frames, source.describe()
    finally:
        source.close()


@pytest.mark.parametrize("method", ["software_trigger", "free_running"])
def test_a_merged_picture_is_the_room(camera: CameraProcess, room: NDArray[np.float64], method: str) -> None:
    exposures_s = [0.1, 0.01, 0.001]
    frames, said = merged_pictures(3, exposures_s=exposures_s, method=method)
    assert said["exposure_s"] == pytest.approx(exposures_s, rel=1e-3)
    for frame in frames:
        assert_is_room(frame, room)
        assert frame.metadata["exposures_s"] == pytest.approx(exposures_s, rel=1e-3)
    times = [frame.timestamp_ns for frame in frames]
    assert times == sorted(set(times))


def test_an_automatic_bracket_comes_to_hold_the_whole_room(
    camera: CameraProcess, room: NDArray[np.float64]
) -> None:
    frames, said = merged_pictures(
        12, num_exposures=3, longest_s=0.2, shortest_s=1e-4, method="software_trigger"
    )
    assert not np.any(frames[-1].pixels[..., 3] < 1.0)
    assert_is_room(frames[-1], room)
    brightest = room.max() / FULL_WELL_RADIANCE
    assert min(said["exposure_s"]) * brightest < 1.0


def assert_is_room(frame: RawFrame, room: NDArray[np.float64]) -> None:
    """Means of 8 x 8 pixels that are measured and of nearly one colour: at edges the demosaicing, judged elsewhere, has a say."""
    shape = (SIDE // 8, 8, SIDE // 8, 8, 3)
    blocks = room.reshape(shape)
    is_plain = blocks.max(axis=(1, 3)) < 1.3 * blocks.min(axis=(1, 3))
    measured = (frame.pixels[..., 3] == 1.0).reshape(shape[:4]).all(axis=(1, 3))
    chosen = is_plain & measured[..., None]
    assert np.count_nonzero(chosen) > 150
    found = frame.pixels[..., :3].astype(np.float64).reshape(shape).mean(axis=(1, 3))
    expected = blocks.mean(axis=(1, 3))
    # Electrons of the longest exposure, and 16 samples of red and blue in a block, 32 of green.
    electrons = 10_000.0 * expected / FULL_WELL_RADIANCE * max(frame.metadata["exposures_s"])
    samples = np.broadcast_to([16.0, 32.0, 16.0], expected.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = found / expected - 1.0
        deviation = np.hypot(np.sqrt((electrons + 3.0**2) / samples) / electrons, 0.005)
    error, deviation = error[chosen], deviation[chosen]
    assert np.quantile(np.abs(error / deviation), 0.95) < 2.5
    weights = deviation**-2
    # The mean is known to 0.15 %; a picture of 1 ms that was exposed for 100 ms would shift it by 1 %.
    assert abs(np.sum(weights * error)) < 4.5 * np.sqrt(np.sum(weights))

"""Small recordings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nearfield_server.recording.files.exr_store import ExrWriter
from nearfield_server.recording.files.frame_info import FrameInfo
from nearfield_server.recording.files.manifest import CameraEntry, Kind, Manifest, TakeEntry, write_manifest
from nearfield_server.recording.files.raw_store import RawWriter

HEIGHT, WIDTH = 6, 10
CAMERAS = (
    CameraEntry(camera_id="left", height=HEIGHT, width=WIDTH, calibration_id="0123456789abcdef"),
    CameraEntry(camera_id="right.2", height=HEIGHT, width=WIDTH, calibration_id="fedcba9876543210"),
)
MS = 1_000_000
START_NS = 10**18 + 1


def picture(seed: int, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """(H, W, 4) float16 of the kinds that rings hold: dark, bright, subnormal, unknown, lower bounds."""
    rng = np.random.default_rng(seed)
    pixels = rng.integers(0, 0x7C00, (height, width, 4)).astype(np.uint16)
    pixels[..., 3] = rng.choice([0x3C00, 0x3BFF, 0], (height, width))
    pixels[pixels[..., 3] == 0] = 0
    return pixels.view(np.float16)


def info(sequence: int, timestamp_ns: int, take: int = 1) -> FrameInfo:
    return FrameInfo(
        take=take,
        sequence=sequence,
        content_revision=(1 << 40) + sequence,
        timestamp_ns=timestamp_ns,
        counters={"saturated": 3},
        metadata={"exposures_s": [0.001, 0.1], "gains": [1.0, 2.0], "device_ns": "12345678901234567890"},
    )


@pytest.fixture
def make_recording(tmp_path: Path) -> Callable[..., Path]:
    """Makes a recording of two cameras: frame s of camera c is `picture(100 c + s)`, taken 100 ms after the one before."""

    def make(kind: Kind, count: int = 4, name: str = "recording", rate: float = 10.0) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        take = TakeEntry(number=1, started_ns=START_NS, started_utc="2026-01-01T00:00:00+00:00")
        write_manifest(
            folder,
            Manifest(
                kind=kind,
                room_name="room",
                software="test",
                boot_id="b",
                frame_rate=rate,
                cameras=CAMERAS,
                takes=(take,),
            ),
        )
        writer = RawWriter(folder, CAMERAS, 1) if kind == "raw" else ExrWriter(folder, CAMERAS)
        for sequence in range(1, count + 1):
            for camera in range(2):
                stamp = START_NS + 100 * MS * (sequence - 1) + camera
                writer.write(camera, info(sequence, stamp), picture(100 * camera + sequence))
        writer.close()
        return folder

    return make

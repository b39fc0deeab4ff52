"""The loop of the capture process with a scripted device, from codes to the ring: faults seen in the status, and healed."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from nearfield_server.bus.backoff import Backoff
from nearfield_server.capture.darkroom import Darkroom
from nearfield_server.capture.device import DeviceCapabilities
from nearfield_server.capture.device_source import DeviceCamera, DeviceSource
from nearfield_server.capture.frame_metadata import parse_metadata
from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.frame_signal import FrameSignal
from nearfield_server.capture.process import FramePump, capture_loop
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.scene.device_schema import AravisSourceTable

SHAPE = RingShape(48, 64)
SCENE = np.geomspace(0.05, 400.0, 48 * 64).reshape(48, 64)
TRIGGER = DeviceCapabilities(exposure_range_s=(1e-5, 1.0), software_trigger=True, device_clock=True)


class FakeWorker:
    """The parts of `Worker` that the loop uses; it stops once `enough` says so."""

    def __init__(self, enough: Callable[[list[dict[str, Any]]], bool]) -> None:
        self.stop, self.control, self._enough = threading.Event(), None, enough
        self.log: Any = type(
            "Log", (), {level: lambda *_args, **_fields: None for level in ("info", "warning")}
        )()
        self.beats: list[dict[str, Any]] = []

    def beat(self, phase: str = "running", **status: Any) -> None:
        if phase == "running":
            self.beats.append(status)
            if self._enough(self.beats):
                self.stop.set()


@pytest.fixture
def fds() -> Iterator[tuple[int, int]]:
    ring, signal = create_ring("cam0", SHAPE), FrameSignal.create()
    yield ring, signal
    os.close(ring)
    os.close(signal)


def _source(device: Any, clock: Any, **table: Any) -> DeviceSource:
    parsed = AravisSourceTable.model_validate(
        {"kind": "aravis", "address": "127.0.0.2", "pixel_format": "Mono12", **table}
    )
    camera = DeviceCamera(camera_id="cam0", table=parsed, height=48, width=64, frame_rate=10.0)
    return DeviceSource(camera, device, Darkroom("cam0", parsed, 64, 48), clock=clock)


def test_a_camera_that_falls_silent_is_opened_until_it_delivers_again(
    fds: tuple[int, int], make_device: Callable[..., Any], clock: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Backoff, "next_delay", lambda self: 0.0)
    start_s = clock() * 1e-9
    device = make_device(
        SCENE,
        capabilities=TRIGGER,
        silent=lambda time_s: 3.0 < time_s - start_s < 10.0,
        gone=lambda time_s: 11.0 < time_s - start_s < 11.1,
    )
    source = _source(device, clock, hdr={"mode": "bracket", "exposures_s": [0.08, 0.02, 0.005, 0.00125]})
    ring, reader = FrameRingWriter(fds[0], "w"), FrameRingReader(fds[0], "r")
    pump = FramePump(source, ring, FrameSignal(fds[1]), None)

    def enough(beats: list[dict[str, Any]]) -> bool:
        return beats[-1]["failures"] >= 2 and beats[-1]["connected"] and beats[-1]["frames"] >= 40

    worker: Any = FakeWorker(enough)
    loop = threading.Thread(
        target=capture_loop, args=(worker, pump, 10.0, lambda: {"source": source.describe()})
    )
    loop.start()
    loop.join(60)
    worker.stop.set()
    assert not loop.is_alive()
    faults = [beat["fault"] for beat in worker.beats]
    assert any("no picture" in fault for fault in faults)
    assert (faults[0], faults[-1]) == ("", "")
    assert worker.beats[-1]["source"]["reconnects"] >= 1
    assert not device.lent
    assert device.closed >= 3
    view = reader.newest()
    assert view is not None
    metadata = parse_metadata(view.metadata)
    assert metadata["exposures_s"] == pytest.approx([0.08, 0.02, 0.005, 0.00125])
    assert set(metadata["frame_ids"]) <= set(device.truth)
    # Well exposed pixels of the bracket, in half floats.
    bright = (SCENE > 3.0) & (SCENE < 400.0)
    error = view.pixels[..., 1].astype(np.float64) / SCENE - 1.0
    assert np.abs(error[bright]).max() < 0.2
    assert np.median(np.abs(error[bright])) < 0.02
    assert (view.pixels[..., 3] == 1.0).all()

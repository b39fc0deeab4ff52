"""A whole service whose cameras are simulated GigE Vision devices, and what its users see of it."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from tests.cameras.harness import (
    FULL_WELL_RADIANCE,
    Cable,
    CameraProcess,
    DeviceCamera,
    write_device_room,
)
from tests.network_namespace import camera_address
from tests.service.harness import PATIENCE_S, Service

from nearfield_server.capture.darkroom import Darkroom
from nearfield_server.capture.device import Exposure, SensorFrame
from nearfield_server.capture.ingest import ingest_frame
from nearfield_server.scene.device_schema import AravisSourceTable


def device_source(address: str, exposure_s: float, **keys: Any) -> dict[str, Any]:
    """The `source` table of a test camera."""
    return {
        "kind": "aravis",
        "address": address,
        "pixel_format": "BayerRG12p",
        "exposure_s": exposure_s,
        "radiance_per_code": FULL_WELL_RADIANCE,
        **keys,
    }


@dataclass
class Rig:
    """Cameras, their cables, and the service that they feed.

    Attributes:
        cameras: by position in the room file.
        service: as users start it.
        exposure_s: of every camera, as the room file says.
        delays: measured seconds by name, for the report; never asserted.
    """

    cameras: list[CameraProcess]
    service: Service
    exposure_s: float
    delays: dict[str, list[float]] = field(default_factory=dict)

    @property
    def cables(self) -> list[Cable]:
        """One per camera."""
        return [Cable(camera.address) for camera in self.cameras]

    def seen(self) -> dict[str, Any]:
        """What `GET /api/status` says."""
        return self.service.api_status()

    def until(self, what: str, condition: Callable[[dict[str, Any]], Any]) -> Any:
        """Ask for the status again and again until `condition(status)` is true, and return its value."""
        end_s = time.monotonic() + PATIENCE_S
        while True:
            status = self.seen()
            with contextlib.suppress(KeyError, IndexError, TypeError):  # a process that has said nothing yet
                if value := condition(status):
                    return value
            if time.monotonic() > end_s:
                shown = {name: status.get(name) for name in ("light", "cameras")}
                raise AssertionError(
                    f"{what} was not seen; status: {json.dumps(shown)}\n{self.service.log_text()[-6000:]}"
                )
            time.sleep(0.05)

    def all_well(self) -> dict[str, Any]:
        """Wait until every camera is live and the light fresh; returns the status."""

        def is_well(status: dict[str, Any]) -> dict[str, Any] | None:
            cameras = status["cameras"]
            well = len(cameras) == len(self.cameras) and all(is_live(camera) for camera in cameras)
            return status if well and not status["light"]["is_stale"] else None

        found: dict[str, Any] = self.until("every camera well", is_well)
        return found

    def events(self, process: str, event: str) -> list[tuple[float, dict[str, Any]]]:
        """Lines of the log: (time since the epoch, fields), oldest first."""
        found = []
        for line in self.service.log_text().splitlines():
            if line.startswith("{") and event in line:
                with contextlib.suppress(ValueError):  # a line that is being written
                    fields = json.loads(line)
                    if fields.get("event") == event and fields.get("process") == process:
                        stamp = datetime.fromisoformat(fields["timestamp"].replace("Z", "+00:00"))
                        found.append((stamp.timestamp(), fields))
        return found

    def note_delay(self, name: str, since: float, process: str, event: str) -> None:
        """Keep how long after `since` (seconds since the epoch) a process first logged an event, for the report."""
        after = [at - since for at, _ in self.events(process, event) if at > since]
        if after:
            self.delays.setdefault(name, []).append(round(after[0], 3))


def is_live(camera: dict[str, Any]) -> bool:
    """Whether an entry of `cameras` says that all is well."""
    return camera["state"] == "live" and not camera["fault"]


@contextlib.contextmanager
def running_rig(
    folder: Path, lab_room: Path, cameras: list[str], first_address: int, exposure_s: float, **room_keys: Any
) -> Iterator[Rig]:
    """Start test cameras and a service.

    Args:
        folder: for room file and log.
        lab_room: what the cameras look at.
        cameras: names of cameras of that room, one per test camera; a name may come several times.
        first_address: number of the first camera's address, see `network_namespace.camera_address`.
        exposure_s: of all cameras.
        room_keys: keys of the room file; `source` may hold further keys of each camera's source.
    """
    source_keys = room_keys.pop("source", {})
    compile_kernels()
    running = [
        CameraProcess(lab_room, name, camera_address(first_address + index), seed=index + 1)
        for index, name in enumerate(cameras)
    ]
    room = write_device_room(
        folder,
        lab_room,
        [
            DeviceCamera(f"cam{index}", name, device_source(camera.address, exposure_s, **source_keys))
            for index, (name, camera) in enumerate(zip(cameras, running, strict=True))
        ],
        **room_keys,
    )
    service: Service | None = None
    try:
        for camera in running:
            camera.ready()
        service = Service(folder / "service.log", room=room)
        yield Rig(running, service, exposure_s)
    finally:
        if service is not None:
            assert service.close() == 0
        for camera in running:
            camera.close()


def compile_kernels() -> None:
    """Develop a picture here, so that four camera processes at once need not compile what does it: they find it in numba's cache."""
    table = AravisSourceTable.model_validate(device_source("127.0.0.1", 1.0))
    frame = SensorFrame(
        data=np.zeros(16 * 16 * 3 // 2, np.uint8),
        pixel_format=table.pixel_format,
        width=16,
        height=16,
        frame_id=0,
        device_ns=0,
        arrival_ns=0,
        exposure=Exposure(time_s=1.0),
    )
    picture = np.zeros((16, 16, 4), np.float16)
    Darkroom("warm", table, 16, 16).develop(frame, frame.exposure, picture)
    ingest_frame(picture, np.zeros_like(picture), np.ones((16, 16), np.bool_))


def open_descriptors(pid: int) -> int:
    """How many files a process has open."""
    return len(os.listdir(f"/proc/{pid}/fd"))


def num_threads(pid: int) -> int:
    """How many threads a process has."""
    return len(os.listdir(f"/proc/{pid}/task"))

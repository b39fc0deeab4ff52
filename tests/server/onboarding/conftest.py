"""Cameras without hardware, and a set-up that uses them."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from nearfield_server.capture.device import Device, DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.errors import CaptureError
from nearfield_server.onboarding.connected import Connected, Listing, in_use
from nearfield_server.onboarding.session import SetupSession
from nearfield_server.onboarding.viewer import Decode
from nearfield_server.scene.device_schema import DeviceSourceTable

TINY_ROOM = Path(__file__).parents[2] / "data" / "tiny_room"

GIGE = Connected(
    kind="gige",
    place="192.168.10.21",
    vendor="Maker",
    model="Eye",
    serial="4711",
    width=120,
    height=100,
    pixel_formats=("Mono8", "BayerRG12p"),
)
USB = Connected(kind="usb3", place="23", vendor="Other", model="Look", serial="23", pixel_formats=("Mono8",))
TAKEN = in_use(Connected(kind="gige", place="192.168.10.22"))
ODD = Connected(kind="usb3", place="24", pixel_formats=("Coord3D",))


class FisheyeDevice:
    """Sees a bright disc of radius 40 around (60, 50) in 120 x 100 pixels; its signal follows the exposure."""

    def __init__(self, name: str, open_now: list[str], broken: set[str]) -> None:
        self.name, self.open_now, self.broken = name, open_now, broken
        self._exposure_s = 0.01

    def open(self) -> DeviceCapabilities:
        if self.name in self.broken:
            raise CaptureError(f"{self.name} is unplugged")
        # A camera can be opened once.
        assert self.name.split(":")[0] not in [name.split(":")[0] for name in self.open_now]
        self.open_now.append(self.name)
        return DeviceCapabilities(exposure_range_s=(0.001, 0.1), settle_frames=0)

    def close(self) -> None:
        if self.name in self.open_now:
            self.open_now.remove(self.name)

    def set_exposure(self, exposure: Exposure) -> Exposure:
        self._exposure_s = exposure.time_s
        return exposure

    def next_frame(self, timeout_s: float) -> SensorFrame | None:
        if timeout_s == 0.0:
            return None
        return SensorFrame(
            data=np.zeros(1, np.uint8),
            pixel_format=self.name.split(":")[1],
            width=120,
            height=100,
            frame_id=1,
            device_ns=None,
            arrival_ns=0,
            exposure=Exposure(time_s=self._exposure_s),
        )

    def release(self, frame: SensorFrame) -> None:
        pass


def decode(frame: SensorFrame) -> np.ndarray:
    rows, columns = np.mgrid[0:100, 0:120]
    signal = np.ones((100, 120, 4), np.float32)
    inside = np.hypot(columns - 60, rows - 50) <= 40
    signal[..., :3] = np.where(inside, 20.0 * frame.exposure.time_s, 0.0)[..., None]
    saturated = (signal[..., 0] >= 1.0).nonzero()
    signal[saturated] = (1.0, 1.0, 1.0, np.uint16(0x3BFF).view(np.float16))
    return signal


class Lab:
    """A set-up in a folder with a model, and what its cameras are doing."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.open_now: list[str] = []
        self.broken: set[str] = set()
        self.searches = 0
        shutil.copy(next(TINY_ROOM.glob("*.glb")), folder / "room.glb")
        self.session = SetupSession(self._search, self._open_camera, folder / "room.toml")
        self.session.search()

    def _search(self) -> Listing:
        assert self.open_now == [], "a camera that is open here would be found in use"
        self.searches += 1
        return Listing(cameras=(GIGE, USB, TAKEN, ODD), notes=("a note",))

    def _open_camera(
        self, camera: Connected, table: DeviceSourceTable
    ) -> tuple[Callable[[], Device], Decode]:
        name = f"{camera.place}:{table.pixel_format}"
        return lambda: FisheyeDevice(name, self.open_now, self.broken), decode  # type: ignore[return-value]


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    folder = tmp_path / "living room"
    folder.mkdir()
    made = Lab(folder)
    yield made
    made.session.close()
    assert made.open_now == []

"""A machine that is a dictionary, and a room of real cameras."""

from __future__ import annotations

import fnmatch
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from nearfield_server.capture.aravis.gvcp import FoundCamera
from nearfield_server.errors import CaptureError, GraphicsError
from nearfield_server.onboarding.gige import AnsweringCamera
from nearfield_server.scene.device_schema import AravisSourceTable, DeviceSourceTable
from nearfield_server.scene.room_config import RoomConfig, load_room

TINY_ROOM = Path(__file__).parents[2] / "data" / "tiny_room"

ROUTES = """Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\tWindow\tIRTT
enp1s0\t00000000\t0101A8C0\t0003\t0\t0\t0\t00000000\t0\t0\t0
enp1s0\t0001A8C0\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0
enp3s0\t000AA8C0\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0
"""


def gige_camera(address: str, is_controlled: bool | None = False) -> AnsweringCamera:
    camera = FoundCamera(
        kind="gige",
        address=address,
        mac="00:11:22:33:44:55",
        vendor="Maker",
        model="Eye",
        serial="4711",
        user_name="",
        interface="",
        is_reachable=True,
    )
    return AnsweringCamera(camera=camera, is_controlled=is_controlled, own_address="192.168.10.1")


@dataclass
class FakeMachine:
    """Everything is in order until a test says otherwise."""

    files: dict[str, str] = field(
        default_factory=lambda: {
            "/proc/sys/net/core/rmem_max": "16777216",
            "/proc/meminfo": "MemTotal: 33554432 kB\nMemAvailable:   16777216 kB\n",
            "/proc/net/route": ROUTES,
            "/sys/class/net/enp3s0/operstate": "up",
            "/sys/class/net/enp3s0/speed": "1000",
            "/sys/class/net/enp3s0/mtu": "9000",
            "/sys/class/net/enp1s0/speed": "1000",
            "/sys/class/net/enp1s0/mtu": "1500",
        }
    )
    forbidden: set[str] = field(default_factory=set)
    processors: int = 4
    python: str = "3.11.7"
    packages: dict[str, str] = field(default_factory=lambda: {"numpy": "2.4.1", "fastapi": "0.121.0"})
    needed: tuple[str, ...] = ("numpy<3,>=2.2", "fastapi<1,>=0.120")
    member_of: frozenset[str] = frozenset({"lab"})
    packet_socket: bool = True
    free: int | None = 500 << 30
    taken: dict[int, str] = field(default_factory=dict)
    gl: tuple[str, bool] | GraphicsError = ("NVIDIA RTX", False)
    aravis: str | CaptureError = "0.8.26"
    synchronised: bool | None = True
    cameras: dict[str, AnsweringCamera | CaptureError] = field(default_factory=dict)
    formats: tuple[str, ...] | CaptureError = ("BayerRG12p", "Mono8")
    asked: list[str] = field(default_factory=list)

    def read(self, path: str) -> str | None:
        return self.files.get(path)

    def names(self, pattern: str) -> tuple[str, ...]:
        return tuple(sorted(path for path in self.files if fnmatch.fnmatch(path, pattern)))

    def may_use(self, path: str) -> bool:
        return path not in self.forbidden

    def num_processors(self) -> int:
        return self.processors

    def python_version(self) -> str:
        return self.python

    def requirements(self) -> tuple[str, ...]:
        return self.needed

    def package_version(self, name: str) -> str | None:
        return self.packages.get(name)

    def user(self) -> str:
        return "ada"

    def groups(self) -> frozenset[str]:
        return self.member_of

    def can_open_packet_socket(self) -> bool:
        return self.packet_socket

    def free_bytes(self, path: Path) -> int | None:
        return self.free

    def why_taken(self, host: str, port: int) -> str:
        return self.taken.get(port, "")

    def renderer(self) -> tuple[str, bool]:
        if isinstance(self.gl, GraphicsError):
            raise self.gl
        return self.gl

    def aravis_version(self) -> str:
        if isinstance(self.aravis, CaptureError):
            raise self.aravis
        return self.aravis

    def clock_is_synchronised(self) -> bool | None:
        return self.synchronised

    def ask_gige(self, address: str) -> AnsweringCamera:
        self.asked.append(address)
        found = self.cameras.get(address, CaptureError(f"no camera answers at {address}"))
        if isinstance(found, CaptureError):
            raise found
        return found

    def pixel_formats(self, source: DeviceSourceTable) -> tuple[str, ...]:
        if isinstance(self.formats, CaptureError):
            raise self.formats
        if isinstance(source, AravisSourceTable) and source.address is not None:
            assert str(source.address) in self.asked, (
                "a camera is asked whether it is free before it is opened"
            )
        return self.formats


@pytest.fixture
def machine() -> FakeMachine:
    return FakeMachine()


CAMERA = """
[[cameras]]
id = "cam{index}"
width = 1024
height = 768
fx = 326.0
fy = 326.0
cx = 511.5
cy = 383.5
theta_max = 1.5
world_from_camera = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
source = {{ {source} }}
"""


@pytest.fixture
def make_room(tmp_path: Path) -> object:
    """Writes a room with a camera for each source table, at 10 frames per second."""

    def make(*sources: str) -> RoomConfig:
        return load_room(write_room(tmp_path, *sources))

    return make


def write_room(folder: Path, *sources: str) -> Path:
    model = next(TINY_ROOM.glob("*.glb"))
    (folder / "room.glb").write_bytes(model.read_bytes())
    text = 'format = 1\nname = "lab"\nmodel = "room.glb"\nframe_rate = 10.0\n'
    if any("remote" in source for source in sources):
        (folder / "certificates").mkdir(exist_ok=True)
        text += '[remote]\nlisten = "192.168.10.1:7448"\ncertificates = "certificates"\n'
    text += "".join(CAMERA.format(index=index, source=source) for index, source in enumerate(sources))
    (folder / "room.toml").write_text(text)
    return folder / "room.toml"

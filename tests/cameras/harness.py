"""Simulated GigE Vision cameras as processes, and room files whose cameras they are."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nearfield_server.scene.room_config import RoomConfig, load_room

PATIENCE_S = 60.0
FULL_WELL_RADIANCE = 1.0
"""Radiance that fills a pixel of a test camera in one second; the room file says the same as `radiance_per_code`."""


class CameraProcess:
    """`python -m nearfield_server.virtual_camera` on one address, and the way to tell it what to do.

    Args:
        room: a room of the virtual lab.
        camera_id: which of its cameras to show.
        address: from `network_namespace.camera_address`.
        options: further options of the command, such as `exposure_delay=2`.
    """

    def __init__(self, room: Path, camera_id: str, address: str, **options: object) -> None:
        self.address, self.serial = address, f"TEST-{camera_id}"
        self._command = [
            *(sys.executable, "-m", "nearfield_server.virtual_camera", str(room)),
            *("--camera", camera_id, "--address", address, "--control"),
            *("--full-well-radiance", str(FULL_WELL_RADIANCE)),
        ]
        for name, value in options.items():
            self._command += [f"--{name.replace('_', '-')}", str(value)]
        self.start()

    def start(self, *extra: str) -> None:
        """Switch the camera on, with further options; settings of an earlier life are gone, as with a real one."""
        self._answers: queue.Queue[dict[str, Any]] = queue.Queue()
        self.process = subprocess.Popen(
            [*self._command, *extra], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        threading.Thread(target=self._listen, args=(self.process, self._answers), daemon=True).start()

    def ready(self) -> CameraProcess:
        """Wait until the camera serves, and return it."""
        if self._answer()["event"] != "ready":
            self.close()
            raise AssertionError(f"camera {self.serial} did not start; its words are above")
        return self

    @staticmethod
    def _listen(process: subprocess.Popen[str], answers: queue.Queue[dict[str, Any]]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            answers.put(json.loads(line))
        answers.put({"event": "ended"})

    def _answer(self) -> dict[str, Any]:
        return self._answers.get(timeout=PATIENCE_S)

    def tell(self, **command: Any) -> dict[str, Any]:
        """Send a command (see `virtual_camera/faults.py`) and return the camera's report after it."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(command) + "\n")
        answer = self._answer()
        assert answer["event"] == "done", answer
        return answer

    def kill(self) -> None:
        """Cut the camera's power."""
        self.process.kill()
        self.process.wait(PATIENCE_S)

    def restart(self, *extra: str) -> None:
        """Cut the power and switch on again, with further options, and wait until the camera serves."""
        self.close()
        self.start(*extra)
        self.ready()

    def freeze(self) -> None:
        """Let the camera hang."""
        self.process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        self.process.send_signal(signal.SIGCONT)

    def cpu_s(self) -> float:
        """CPU time that the camera has used, seconds."""
        return cpu_seconds(self.process.pid)

    def close(self) -> None:
        """End the process, whatever state it is in, and take its pipes away."""
        self.kill()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


def cpu_seconds(pid: int) -> float:
    """CPU time that a process has used, seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def thread_cpu_seconds(pid: int, prefix: str) -> float:
    """CPU time of the threads of a process whose names begin with `prefix`, seconds."""
    total = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        name, _, rest = (task / "stat").read_text().partition("(")[2].rpartition(")")
        if name.startswith(prefix):
            total += sum(int(value) for value in rest.split()[11:13])
    return total / os.sysconf("SC_CLK_TCK")


class Cable:
    """The way to a camera, which can be pulled: packets from and to its address are dropped, and nobody is told."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._table = f"cable_{address.replace('.', '_')}"

    def pull(self) -> None:
        """Cut it."""
        _nft(
            f"table ip {self._table} {{\n chain cut {{\n  type filter hook output priority 0;\n"
            f"  ip saddr {self.address} drop\n  ip daddr {self.address} drop\n }}\n}}\n"
        )

    def plug(self) -> None:
        """Mend it; may be called twice."""
        _nft(f"table ip {self._table}\ndelete table ip {self._table}\n")


def _nft(rules: str) -> None:
    subprocess.run(["/usr/sbin/nft", "-f", "-"], input=rules, text=True, check=True, timeout=PATIENCE_S)


@dataclass(frozen=True)
class DeviceCamera:
    """A camera of a room file that is a device: its name, the camera of the virtual lab whose place it takes, its `source` table."""

    camera_id: str
    lab_camera: str
    source: dict[str, Any]


def in_place_of(lab_room: Path, sources: list[dict[str, Any]]) -> list[DeviceCamera]:
    """Devices for the first cameras of a room, under the same names."""
    names = [camera.camera_id for camera in load_room(lab_room).cameras]
    return [DeviceCamera(name, name, source) for name, source in zip(names, sources, strict=False)]


def write_device_room(folder: Path, lab_room: Path, cameras: list[DeviceCamera], **room_keys: Any) -> Path:
    """Write a room file like a room of the virtual lab whose cameras are devices.

    Args:
        folder: where room.toml goes.
        lab_room: the room with simulated cameras; models, lights and views are taken from it.
        cameras: of the new room.
        room_keys: keys of the room, such as `frame_rate=10.0`.

    Returns:
        Path of room.toml.
    """
    room = load_room(lab_room)
    by_name = {camera.camera_id: camera for camera in room.cameras}
    keys = {
        "name": room.name,
        "model": room.model_path.resolve(),
        "atlas_size": room.atlas_size,
        **room_keys,
    }
    lines = ["format = 1", *(_pair(key, value) for key, value in keys.items()), *_furniture(room)]
    for camera in cameras:
        place = by_name[camera.lab_camera]
        lens = place.intrinsics
        lines += [
            "[[cameras]]",
            _pair("id", camera.camera_id),
            *(_pair(key, getattr(lens, key)) for key in ("width", "height", "fx", "fy", "cx", "cy")),
            _pair("k", list(lens.k)),
            _pair("theta_max", lens.theta_max),
            _pair("world_from_camera", place.world_from_camera),
            _pair("source", camera.source),
        ]
    file = folder / "room.toml"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def _furniture(room: RoomConfig) -> list[str]:
    lines: list[str] = []
    for light in room.lights:
        lines += [
            "[[lights]]",
            *(_pair(key, getattr(light, key)) for key in ("name", "radiance", "basis_radiance", "weight")),
        ]
    for item in room.objects:
        lines += [
            "[[objects]]",
            _pair("name", item.name),
            _pair("model", item.model_path.resolve()),
            _pair("albedo", item.albedo),
            _pair("world_from_object", item.world_from_object),
        ]
    for view in room.views:
        pinhole = view.intrinsics
        lines += [
            "[[views]]",
            _pair("id", view.view_id),
            *(_pair(key, getattr(pinhole, key)) for key in ("width", "height", "fx", "fy", "cx", "cy")),
            _pair("world_from_camera", view.world_from_camera),
            _pair("background", [str((room.folder / name).resolve()) for name in view.background_files]),
        ]
    return lines


def _pair(key: str, value: Any) -> str:
    return f"{key} = {_toml(value)}"


def _toml(value: Any) -> str:
    """A value as TOML has it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float | np.number):
        return repr(value.item() if isinstance(value, np.number) else value)
    if isinstance(value, str | Path):
        return json.dumps(str(value))
    if isinstance(value, dict):
        return "{ " + ", ".join(_pair(key, entry) for key, entry in value.items()) + " }"
    if isinstance(value, np.ndarray):
        return _toml(value.tolist())
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(entry) for entry in value) + "]"
    raise TypeError(f"{type(value).__name__} cannot be written as TOML")


def wait_until(what: str, condition: Any, patience_s: float = PATIENCE_S) -> Any:
    """Ask `condition()` again and again until it is true, and return its value."""
    end = time.monotonic() + patience_s
    while not (value := condition()):
        assert time.monotonic() < end, f"{what} did not happen"
        time.sleep(0.02)
    return value

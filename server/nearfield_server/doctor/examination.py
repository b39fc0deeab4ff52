"""All checks of a machine, with or without a room."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from nearfield_server.capture.ring_memory import RingShape
from nearfield_server.doctor.devices import check_usb, check_video
from nearfield_server.doctor.finding import Finding, ok, problem
from nearfield_server.doctor.machine import Machine
from nearfield_server.doctor.network import (
    check_interfaces,
    check_packet_socket,
    check_ports,
    check_receive_buffer,
)
from nearfield_server.doctor.room_cameras import (
    check_certificates,
    check_room_cameras,
    gige_streams,
    recorded_bytes_per_s,
)
from nearfield_server.doctor.software import (
    check_aravis,
    check_graphics,
    check_packages,
    check_page,
    check_python,
)
from nearfield_server.doctor.system import (
    check_clock,
    check_disk,
    check_governor,
    check_memory,
    check_processor,
)
from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.scene.device_schema import AravisSourceTable, V4l2SourceTable
from nearfield_server.scene.room_config import RoomConfig, load_room

_OTHER_PROCESSES = 3  # supervisor, illumination, gateway


def examine(
    machine: Machine,
    room_path: Path | None,
    *,
    static_dir: Path,
    recordings: Path,
    port: int = 8080,
    host: str = "127.0.0.1",
) -> list[Finding]:
    """Run every check.

    Args:
        machine: what is asked.
        room_path: the room that will be served, if there is one yet.
        static_dir: where the built client lies.
        recordings: folder that recordings would go to.
        port: of the page.
        host: address that the page would be served on.
    """
    room, findings = _load(room_path)
    sources = () if room is None else room.sources
    streams = [] if room is None else gige_streams(room)
    video = tuple(source.path for source in sources if isinstance(source, V4l2SourceTable))
    aravis = [source for source in sources if isinstance(source, AravisSourceTable)]
    shapes = (
        [] if room is None else [RingShape(c.intrinsics.height, c.intrinsics.width) for c in room.cameras]
    )
    checks: list[Callable[[], Finding | Sequence[Finding]]] = [
        lambda: check_python(machine),
        lambda: check_packages(machine),
        lambda: check_aravis(machine, bool(aravis)),
        lambda: check_video(machine, video),
        lambda: check_usb(machine),
        lambda: check_packet_socket(machine),
        lambda: check_receive_buffer(machine, streams),
        lambda: check_interfaces(machine, streams),
        lambda: check_graphics(machine),
        lambda: check_memory(
            machine, sum(shape.total_bytes for shape in shapes), _OTHER_PROCESSES + len(shapes)
        ),
        lambda: check_disk(machine, recordings, 0.0 if room is None else recorded_bytes_per_s(room)),
        lambda: check_ports(machine, port, host),
        lambda: check_clock(machine, uses_ptp=any(_uses_ptp(source) for source in aravis)),
        lambda: check_processor(machine),
        lambda: check_governor(machine),
        lambda: check_page(static_dir),
        lambda: [] if room is None else check_room_cameras(machine, room),
        lambda: [] if room is None else check_certificates(room),
    ]
    for check in checks:
        found = check()
        findings += [found] if isinstance(found, Finding) else found
    return findings


def _load(room_path: Path | None) -> tuple[RoomConfig | None, list[Finding]]:
    if room_path is None:
        return None, []
    try:
        room = load_room(room_path)
    except (ConfigError, AssetError) as error:
        return None, [problem("room", str(error), f"correct {room_path}; keys: server/README.md")]
    return room, [
        ok("room", f"{room.name}: {len(room.cameras)} {'camera' if len(room.cameras) == 1 else 'cameras'}")
    ]


def _uses_ptp(source: AravisSourceTable) -> bool:
    return any(source.features.get(name) is True for name in ("PtpEnable", "GevIEEE1588"))

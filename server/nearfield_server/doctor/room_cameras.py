"""The cameras that a room names: there, free, and able to send what the room expects."""

from __future__ import annotations

from collections.abc import Sequence

from nearfield_server.capture.remote.gate import check_service_certificate
from nearfield_server.capture.v4l2.formats import find_format
from nearfield_server.doctor.finding import Finding, ok, problem, warning
from nearfield_server.doctor.machine import Machine
from nearfield_server.doctor.network import GigeStream
from nearfield_server.errors import CaptureError, ConfigError
from nearfield_server.imaging.pixel_formats import pixel_format
from nearfield_server.recording.space import TYPICAL_RATIO, most_bytes_per_second
from nearfield_server.records import CameraModel
from nearfield_server.scene.device_schema import (
    AravisSourceTable,
    BracketTable,
    DeviceSourceTable,
    RemoteSourceTable,
    V4l2SourceTable,
)
from nearfield_server.scene.room_config import RoomConfig

_UNKNOWN_BITS = 16
_COMPRESSED_BITS = 4


def bits_per_pixel(source: DeviceSourceTable) -> int:
    """Bits of a pixel as the device sends it; 16 for names that are not known, 4 for compressed pictures, which vary."""
    try:
        if isinstance(source, V4l2SourceTable):
            return find_format(source.pixel_format).bits_per_pixel or _COMPRESSED_BITS
        return pixel_format(source.pixel_format).pixel_bits or _COMPRESSED_BITS
    except CaptureError:
        return _UNKNOWN_BITS


def frame_bytes(camera: CameraModel, source: DeviceSourceTable) -> int:
    """Payload of one frame."""
    width, height = camera.intrinsics.width, camera.intrinsics.height
    if isinstance(source, AravisSourceTable) and source.region is not None:
        width, height = source.region[2:]
    return width * height * bits_per_pixel(source) // 8


def exposures_per_picture(source: DeviceSourceTable) -> int:
    """Frames that a picture is merged from."""
    hdr = source.hdr
    if not isinstance(hdr, BracketTable):
        return 1
    return len(hdr.exposures_s) or hdr.num_exposures


def gige_streams(room: RoomConfig) -> list[GigeStream]:
    """What the GigE cameras of a room send: those with an address, and those with a network interface to be found on."""
    return [
        GigeStream(
            camera_id=camera.camera_id,
            address=str(source.address or ""),
            interface=source.interface or "",
            payload=frame_bytes(camera, source),
            frame_rate=room.frame_rate * exposures_per_picture(source),
        )
        for camera, source in zip(room.cameras, room.sources, strict=True)
        if isinstance(source, AravisSourceTable) and (source.address or source.interface)
    ]


def recorded_bytes_per_s(room: RoomConfig) -> float:
    """Bytes per second that a recording takes, as `nearfield record` says it too."""
    sizes = [(camera.intrinsics.height, camera.intrinsics.width) for camera in room.cameras]
    return TYPICAL_RATIO * most_bytes_per_second(sizes, room.frame_rate)


def check_room_cameras(machine: Machine, room: RoomConfig) -> list[Finding]:
    """One finding for each camera of the room that is a device or on another machine."""
    findings = []
    for camera, source in zip(room.cameras, room.sources, strict=True):
        name = f"camera {camera.camera_id}"
        if isinstance(source, AravisSourceTable):
            findings.append(_check_aravis(machine, name, source))
        elif isinstance(source, V4l2SourceTable):
            findings.append(_check_v4l2(machine, name, source))
        elif isinstance(source, RemoteSourceTable):
            findings.append(ok(name, f"of node {source.node}: run `nearfield doctor` there too"))
    return findings


def check_certificates(room: RoomConfig) -> list[Finding]:
    """The certificate that camera nodes are shown, if the room has any; nodes check their own."""
    if room.remote is None:
        return []
    try:
        warnings = check_service_certificate(room)
    except ConfigError as error:
        return [problem("certificates", str(error), "nearfield certificates room --help")]
    if warnings:
        return [warning("certificates", "; ".join(warnings), "nearfield certificates room --help")]
    return [ok("certificates", f"valid for {room.remote.address}")]


def _check_aravis(machine: Machine, name: str, source: AravisSourceTable) -> Finding:
    if source.address is not None:
        return _check_gige(machine, name, source)
    if source.interface is not None:
        return warning(
            name,
            f"serial {source.serial} on {source.interface}: not looked for, because that is a broadcast",
            f"nearfield cameras --interface {source.interface}",
        )
    return _check_usb(machine, name, source)


def _check_gige(machine: Machine, name: str, source: AravisSourceTable) -> Finding:
    address = str(source.address)
    try:
        found = machine.ask_gige(address)
    except CaptureError as error:
        return problem(
            name,
            str(error),
            f"ping -c 1 {address}   # nearfield cameras --interface INTERFACE finds the addresses of cameras",
        )
    who = f"{found.camera.vendor} {found.camera.model} {found.camera.serial} at {address}"
    if found.is_controlled:
        return warning(
            name,
            f"{who}: controlled by another program",
            "end that program, a running `nearfield serve` too; a camera frees itself a few seconds later",
        )
    try:
        formats = machine.pixel_formats(source)
    except CaptureError as error:
        return warning(
            name, f"{who} answers, but cannot be opened: {error}", f"nearfield cameras --address {address}"
        )
    return _check_format(name, who, source.pixel_format, formats)


def _check_usb(machine: Machine, name: str, source: AravisSourceTable) -> Finding:
    try:
        formats = machine.pixel_formats(source)
    except CaptureError as error:
        return problem(name, str(error), "nearfield cameras")
    return _check_format(name, f"USB3 Vision camera {source.serial}", source.pixel_format, formats)


def _check_v4l2(machine: Machine, name: str, source: V4l2SourceTable) -> Finding:
    if not machine.names(source.path):
        return problem(
            name, f"{source.path} is not there", "nearfield cameras   # lists what is, with stable paths"
        )
    if not machine.may_use(source.path):
        return problem(
            name,
            f"{source.path}: this user may not use it",
            f"sudo usermod -aG video {machine.user()}   # then log in again",
        )
    try:
        # Rooms may name a format by its four characters, its usual name, or as frames do.
        usual_name = find_format(source.pixel_format).usual_name
        formats = machine.pixel_formats(source)
    except CaptureError as error:
        return problem(name, str(error), "nearfield cameras")
    return _check_format(name, source.path, usual_name, formats)


def _check_format(name: str, who: str, wanted: str, formats: Sequence[str]) -> Finding:
    if wanted in formats or not formats:
        return ok(name, f"{who}: free, {wanted}")
    return problem(
        name,
        f"{who} does not offer {wanted}, but {', '.join(formats)}",
        f'in the room file: pixel_format = "{formats[0]}"',
    )

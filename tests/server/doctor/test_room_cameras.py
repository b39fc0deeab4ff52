"""The cameras of a room: payloads in closed form, and everything that a camera may answer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from nearfield_server.capture.remote.certificates import new_room
from nearfield_server.doctor.finding import Level
from nearfield_server.doctor.room_cameras import (
    bits_per_pixel,
    check_certificates,
    check_room_cameras,
    gige_streams,
    recorded_bytes_per_s,
)
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import AravisSourceTable, V4l2SourceTable
from nearfield_server.scene.room_config import RoomConfig

from .conftest import FakeMachine, gige_camera
from .test_checks import expect

OK, WARNING, PROBLEM = Level.OK, Level.WARNING, Level.PROBLEM
MakeRoom = Callable[..., RoomConfig]
BY_ADDRESS = 'kind = "aravis", address = "192.168.10.21"'


@pytest.mark.parametrize(
    ("name", "bits"),
    [
        ("Mono8", 8),
        ("Mono10", 16),
        ("Mono10p", 10),
        ("Mono12Packed", 12),
        ("BayerRG12p", 12),
        ("BayerGB16", 16),
        ("RGB8", 24),
        ("Coord3D", 16),
    ],
)
def test_bits_of_pixels_over_the_wire(name: str, bits: int) -> None:
    assert bits_per_pixel(AravisSourceTable(kind="aravis", serial="1", pixel_format=name)) == bits


@pytest.mark.parametrize(
    ("name", "bits"), [("YUYV", 16), ("SRGGB12P", 12), ("GREY", 8), ("MJPG", 4), ("XXXX", 16)]
)
def test_bits_of_pixels_of_video_devices(name: str, bits: int) -> None:
    assert bits_per_pixel(V4l2SourceTable(kind="v4l2", path="/dev/video0", pixel_format=name)) == bits


def test_what_cameras_send(make_room: MakeRoom) -> None:
    room = make_room(
        BY_ADDRESS,
        'kind = "aravis", address = "192.168.10.22", pixel_format = "Mono8", region = [0, 0, 100, 50]',
        BY_ADDRESS.replace("21", "23") + ', hdr = { mode = "bracket", exposures_s = [0.01, 0.001, 0.0001] }',
        'kind = "aravis", serial = "1"',
        'kind = "aravis", serial = "2", interface = "enp3s0", pixel_format = "Mono8", region = [0, 0, 10, 10]',
        'kind = "remote", node = "window", camera = "cam9"',
    )
    streams = gige_streams(room)
    assert [(s.camera_id, s.address, s.payload, s.frame_rate) for s in streams] == [
        ("cam0", "192.168.10.21", 1024 * 768 * 3 // 2, 10.0),
        ("cam1", "192.168.10.22", 5000, 10.0),
        ("cam2", "192.168.10.23", 1024 * 768 * 3 // 2, 30.0),
        ("cam4", "", 100, 10.0),
    ]
    assert [s.interface for s in streams] == ["", "", "", "enp3s0"]
    # Recorded are half floats of four channels, however the camera sent them.
    assert recorded_bytes_per_s(room) == pytest.approx(0.4 * 6 * 10 * 1024 * 768 * 8)


def test_gige_cameras(make_room: MakeRoom, machine: FakeMachine) -> None:
    room = make_room(BY_ADDRESS)
    (finding,) = check_room_cameras(machine, room)
    expect(finding, PROBLEM, "no camera answers at 192.168.10.21", "ping -c 1")
    machine.cameras["192.168.10.21"] = gige_camera("192.168.10.21")
    (finding,) = check_room_cameras(machine, room)
    expect(finding, OK, "Maker Eye 4711 at 192.168.10.21", "free", "BayerRG12p")
    machine.formats = ("Mono8", "Mono12")
    (finding,) = check_room_cameras(machine, room)
    expect(finding, PROBLEM, "does not offer BayerRG12p, but Mono8, Mono12", 'pixel_format = "Mono8"')
    machine.formats = CaptureError("odd GenICam file")
    (finding,) = check_room_cameras(machine, room)
    expect(finding, WARNING, "odd GenICam file", "nearfield cameras --address 192.168.10.21")


def test_a_camera_of_somebody_else_is_not_opened(make_room: MakeRoom, machine: FakeMachine) -> None:
    machine.cameras["192.168.10.21"] = gige_camera("192.168.10.21", is_controlled=True)
    machine.formats = CaptureError("must not be called")
    (finding,) = check_room_cameras(machine, make_room(BY_ADDRESS))
    expect(finding, WARNING, "controlled by another program")


def test_cameras_by_serial(make_room: MakeRoom, machine: FakeMachine) -> None:
    by_serial = 'kind = "aravis", serial = "23", interface = "enp3s0"'
    looked_for, usb = check_room_cameras(machine, make_room(by_serial, 'kind = "aravis", serial = "42"'))
    expect(looked_for, WARNING, "broadcast", "nearfield cameras --interface enp3s0")
    assert machine.asked == []
    expect(usb, OK, "USB3 Vision camera 42")
    machine.formats = CaptureError("no such camera")
    (usb,) = check_room_cameras(machine, make_room('kind = "aravis", serial = "42"'))
    expect(usb, PROBLEM, "no such camera", "nearfield cameras")


def test_video_cameras(make_room: MakeRoom, machine: FakeMachine) -> None:
    path = "/dev/v4l/by-id/usb-eye"
    room = make_room(f'kind = "v4l2", path = "{path}"')
    (finding,) = check_room_cameras(machine, room)
    expect(finding, PROBLEM, "is not there", "nearfield cameras")
    machine.files[path] = ""
    machine.formats = ("YUYV", "MJPG")
    (finding,) = check_room_cameras(machine, room)
    expect(finding, OK, path, "YUYV")
    machine.formats = ("MJPEG",)
    (finding,) = check_room_cameras(machine, room)
    expect(finding, PROBLEM, "does not offer YUYV, but MJPEG")
    for alias in ("MJPG", "mjpeg"):
        as_written = make_room(f'kind = "v4l2", path = "{path}", pixel_format = "{alias}"')
        (finding,) = check_room_cameras(machine, as_written)
        expect(finding, OK, "MJPEG")
    (finding,) = check_room_cameras(
        machine, make_room(f'kind = "v4l2", path = "{path}", pixel_format = "NONE"')
    )
    expect(finding, PROBLEM, "expected a V4L2 format")
    machine.formats = CaptureError("busy")
    (finding,) = check_room_cameras(machine, room)
    expect(finding, PROBLEM, "busy")
    machine.forbidden.add(path)
    (finding,) = check_room_cameras(machine, room)
    expect(finding, PROBLEM, "usermod -aG video ada")


def test_cameras_of_other_machines_are_left_to_them(make_room: MakeRoom, machine: FakeMachine) -> None:
    (finding,) = check_room_cameras(machine, make_room('kind = "remote", node = "window", camera = "cam9"'))
    expect(finding, OK, "node window")


def test_certificates_for_camera_nodes(make_room: MakeRoom, tmp_path: Path) -> None:
    assert check_certificates(make_room(BY_ADDRESS)) == []
    room = make_room('kind = "remote", node = "window", camera = "cam9"')
    (finding,) = check_certificates(room)
    expect(finding, PROBLEM, "ca.pem", "nearfield certificates")
    new_room(tmp_path / "certificates", ["192.168.10.1"])
    (finding,) = check_certificates(room)
    expect(finding, OK, "192.168.10.1:7448")
    (tmp_path / "certificates" / "service.key").chmod(0o644)
    (finding,) = check_certificates(room)
    expect(finding, WARNING, "chmod 600")

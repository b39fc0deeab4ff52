"""What a simulated camera can be told, its clock, and where it refuses to run."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from nearfield_server.errors import ConfigError
from nearfield_server.scene.room_config import load_room
from nearfield_server.virtual_camera import device
from nearfield_server.virtual_camera.clock import DeviceClock
from nearfield_server.virtual_camera.device import check_network
from nearfield_server.virtual_camera.faults import CameraState, parse_command
from nearfield_server.virtual_camera.scenery import Scenery

TINY_ROOM = Path(__file__).parents[2] / "data" / "tiny_room"


def test_a_command_changes_what_it_names_and_nothing_else() -> None:
    before = CameraState(lights=(1.0, 1.0), loss=0.5)
    command = parse_command('{"lights": [0, 2], "picture": "black", "ExposureTime": 500}', 2)
    assert command.apply(before) == CameraState(lights=(0.0, 2.0), picture="black", loss=0.5)
    assert command.floats == {"ExposureTime": 500.0}
    assert parse_command("{}", 2).apply(before) == before


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("nonsense", "not JSON"),
        ("[1]", "expected a JSON object"),
        ('{"lights": [1]}', "1 weights for 2 lights"),
        ('{"lights": [1, -1]}', ">= 0"),
        ('{"lights": 7}', "impossible"),
        ('{"picture": "green"}', "saturated"),
        ('{"loss": 2}', "0 to 1"),
        ('{"explode": true}', "explode"),
        ('{"pixel_format": "YUV411"}', "YUV411"),
    ],
)
def test_an_impossible_command_is_refused_in_words(line: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_command(line, 2)


def test_a_clock_changes_speed_without_a_jump_and_jumps_without_changing_speed() -> None:
    clock = DeviceClock(host_ns=1_000)
    assert clock.at(1_000) == 0
    clock.run_at(100.0, 1_001_000)
    assert clock.at(1_001_000) == 1_000_000
    assert clock.at(2_001_000) - clock.at(1_001_000) == 1_000_100
    clock.jump(-500)
    assert clock.at(1_001_000) == 999_500


@pytest.mark.parametrize("address", ["192.168.1.5", "0.0.0.0", "10.0.0.1", "localhost", "::1", ""])
def test_only_addresses_of_loopback_are_allowed(address: str) -> None:
    with pytest.raises(ConfigError, match="loopback alone"):
        check_network(address)


def test_a_network_with_another_interface_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(1, "lo"), (2, "eth0")])
    monkeypatch.setattr(device, "_is_up", lambda name: True)
    with pytest.raises(ConfigError, match="eth0 is up"):
        check_network("127.0.0.2")
    # Interfaces that are switched off carry nothing; every new namespace has some.
    monkeypatch.setattr(device, "_is_up", lambda name: False)
    check_network("127.0.0.2")


def test_a_camera_that_the_room_does_not_have_is_named() -> None:
    with pytest.raises(ConfigError, match=r"no camera 'cam9'; there are 0, 1"):
        Scenery(load_room(TINY_ROOM), "cam9")

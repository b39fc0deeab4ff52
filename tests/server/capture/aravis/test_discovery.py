"""Answers of cameras are read strictly; USB3 Vision cameras are read from sysfs."""

import ipaddress
import struct
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from nearfield_server.capture.aravis import discovery
from nearfield_server.capture.aravis.gvcp import (
    FoundCamera,
    decode_discovery,
    decode_reply,
    discovery_command,
    encode_command,
)
from nearfield_server.errors import CaptureError

SUBNET = ipaddress.IPv4Network("192.168.10.0/24")


def answer(
    address: str = "192.168.10.21", serial: bytes = b"23104452", vendor: bytes = b"Sensor Ltd."
) -> bytes:
    """A discovery answer, written field by field after the standard (GigE Vision 2.0, table 16-4), not by our code."""
    payload = bytearray(248)
    struct.pack_into(">HHIHHI", payload, 0, 2, 0, 0x80000001, 0, 0x0011, 0x22AABBCC)
    payload[36:40] = ipaddress.IPv4Address(address).packed
    payload[72 : 72 + len(vendor)] = vendor
    payload[104:108] = b"M100"
    payload[216 : 216 + len(serial)] = serial
    payload[232:238] = b"fish-0"
    return struct.pack(">HHHH", 0, 3, 248, 0xFFFF) + bytes(payload)


def test_the_command_is_that_of_the_standard() -> None:
    assert discovery_command() == bytes([0x42, 0x11, 0, 2, 0, 0, 0xFF, 0xFF])
    assert discovery_command(to_all=False) == bytes([0x42, 0x01, 0, 2, 0, 0, 0xFF, 0xFF])
    assert encode_command(0x80, b"\0\0\x0a\0", 7) == bytes([0x42, 1, 0, 0x80, 0, 4, 0, 7, 0, 0, 0x0A, 0])


def test_an_answer_is_read() -> None:
    assert decode_discovery(answer(), "enp3s0", SUBNET) == FoundCamera(
        kind="gige",
        address="192.168.10.21",
        mac="00:11:22:aa:bb:cc",
        vendor="Sensor Ltd.",
        model="M100",
        serial="23104452",
        user_name="fish-0",
        interface="enp3s0",
        is_reachable=True,
    )


def test_a_camera_outside_the_network_is_listed_with_advice() -> None:
    found = decode_discovery(answer("169.254.7.7"), "enp3s0", SUBNET)
    assert found is not None
    assert not found.is_reachable
    assert "192.168.10.0/24" in found.advice


@pytest.mark.parametrize("address", ["255.255.255.255", "224.0.0.251", "240.0.0.1"])
def test_addresses_that_no_camera_has_are_no_cameras(address: str) -> None:
    assert decode_discovery(answer(address), "enp3s0", SUBNET) is None


def test_names_cannot_carry_control_characters() -> None:
    found = decode_discovery(answer(serial=b"\x1b[2J\xff\n'", vendor=b"<b>\r\n"), "enp3s0", SUBNET)
    assert found is not None
    assert (found.serial + found.vendor).isprintable()


@given(st.binary(max_size=400))
@example(b"")
@example(answer()[:-1])
@example(answer() + b"\0")
@example(answer()[:100])
def test_any_other_datagram_is_no_camera(packet: bytes) -> None:
    assert decode_discovery(packet, "enp3s0", SUBNET) is None


@given(st.data())
def test_an_answer_with_any_content_gives_printable_texts_or_nothing(data: st.DataObject) -> None:
    packet = answer()[:8] + data.draw(st.binary(min_size=248, max_size=248))
    found = decode_discovery(packet, "enp3s0", SUBNET)
    if found is not None:
        assert all(getattr(found, name).isprintable() for name in ("vendor", "model", "serial", "user_name"))
        assert not ipaddress.IPv4Address(found.address).is_multicast


def test_a_refusal_is_told_in_words() -> None:
    with pytest.raises(CaptureError, match="access denied"):
        decode_reply(struct.pack(">HHHH", 0x8006, 0x81, 0, 5), 0x80, 5)
    assert decode_reply(struct.pack(">HHHH", 0x8006, 0x81, 0, 6), 0x80, 5) is None  # answers another question


def usb_device(sysfs: Path, name: str, serial: str, subclass: str = "05", speed: str = "5000") -> None:
    device = sysfs / "tree" / name
    interface = device / f"{name}:1.0"
    interface.mkdir(parents=True)
    for attribute, value in {"manufacturer": "Sensor Ltd.", "product": "U3-100", "serial": serial}.items():
        (device / attribute).write_text(value + "\n")
    for attribute, value in {"busnum": "2", "devnum": "7", "speed": speed, "idVendor": "1ab2"}.items():
        (device / attribute).write_text(value + "\n")
    (interface / "bInterfaceClass").write_text("ef\n")
    (interface / "bInterfaceSubClass").write_text(subclass + "\n")
    (sysfs / interface.name).symlink_to(interface)


def test_usb_cameras_are_read_from_sysfs(tmp_path: Path) -> None:
    usb_device(tmp_path, "2-1", "U001")
    usb_device(tmp_path, "2-2", "webcam", subclass="02")
    (found,) = discovery.list_usb_cameras(tmp_path)
    assert (found.kind, found.serial, found.vendor, found.model) == ("usb3", "U001", "Sensor Ltd.", "U3-100")
    assert not found.is_reachable  # there is no such device on this machine
    assert "idVendor" in found.advice
    assert "1ab2" in found.advice
    assert discovery.list_usb_cameras(tmp_path / "nothing") == []


def test_an_unknown_interface_is_told_with_those_there_are() -> None:
    with pytest.raises(CaptureError, match=r"no.* called nosuchif0; there are: .*lo"):
        discovery.list_cameras("nosuchif0")


def test_a_serial_must_be_that_of_one_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    first = decode_discovery(answer(), "enp3s0", SUBNET)
    second = decode_discovery(answer("192.168.10.22"), "enp3s0", SUBNET)
    far = decode_discovery(answer("10.0.0.9", serial=b"far"), "enp3s0", SUBNET)
    assert first is not None
    assert second is not None
    assert far is not None
    monkeypatch.setattr(discovery, "list_cameras", lambda interface: [first, far])
    assert discovery.find_by_serial("23104452", "enp3s0") is first
    with pytest.raises(
        CaptureError, match=r"serial 99 on interface enp3s0, found no camera; there: .*23104452"
    ):
        discovery.find_by_serial("99", "enp3s0")
    with pytest.raises(CaptureError, match="cannot be opened: give the camera an address"):
        discovery.find_by_serial("far", "enp3s0")
    monkeypatch.setattr(discovery, "list_cameras", lambda interface: [first, second])
    with pytest.raises(CaptureError, match="found 2 cameras"):
        discovery.find_by_serial("23104452", "enp3s0")

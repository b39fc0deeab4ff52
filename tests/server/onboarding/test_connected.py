"""Listings: what is asked, what fails alone, what people and programs read."""

from __future__ import annotations

import json
from collections.abc import Sequence

import pytest

from nearfield_server.errors import CaptureError
from nearfield_server.onboarding.connected import (
    HOW_TO_ADD_AN_INTERFACE,
    Connected,
    Details,
    Listing,
    as_json,
    as_table,
    in_use,
    list_connected,
)

GIGE = Connected(
    kind="gige", place="192.168.10.21", vendor="Maker", model="Eye", serial="4711", interface="enp3s0"
)
USB = Connected(kind="usb3", place="23", vendor="Other", model="Look", serial="23")
VIDEO = Connected(
    kind="v4l2",
    place="/dev/v4l/by-id/usb-web",
    model="Webcam",
    width=640,
    height=480,
    pixel_formats=("YUYV",),
)


class FakeFinder:
    def __init__(self) -> None:
        self.asked: list[str] = []
        self.usb: Sequence[Connected] | CaptureError = [USB]
        self.details_of: dict[str, Details | CaptureError] = {}

    def on_interface(self, interface: str) -> Sequence[Connected]:
        self.asked.append(interface)
        if interface != "enp3s0":
            raise CaptureError(f"no interface {interface}")
        return [GIGE, in_use(Connected(kind="gige", place="192.168.10.22"))]

    def at_address(self, address: str) -> Connected:
        self.asked.append(address)
        return Connected(kind="gige", place=address)

    def on_usb(self) -> Sequence[Connected]:
        if isinstance(self.usb, CaptureError):
            raise self.usb
        return self.usb

    def video(self) -> Sequence[Connected]:
        return [VIDEO]

    def details(self, camera: Connected) -> Details:
        self.asked.append(f"details of {camera.place}")
        found = self.details_of.get(
            camera.place, Details(width=1024, height=768, pixel_formats=("Mono8", "BayerRG12p"))
        )
        if isinstance(found, CaptureError):
            raise found
        return found


def test_networks_are_left_alone_unless_they_are_named() -> None:
    finder = FakeFinder()
    listing = list_connected(finder, with_details=False)
    assert finder.asked == []
    assert listing == Listing(cameras=(USB, VIDEO), notes=(HOW_TO_ADD_AN_INTERFACE,))


def test_named_interfaces_and_addresses_are_asked_and_nothing_else() -> None:
    finder = FakeFinder()
    listing = list_connected(finder, ["enp3s0"], ["192.168.10.21", "10.0.0.5"])
    assert [camera.place for camera in listing.cameras] == [
        "192.168.10.21",
        "192.168.10.22",
        "10.0.0.5",
        "23",
        "/dev/v4l/by-id/usb-web",
    ]
    assert listing.notes == ()
    # The camera that is in use is not opened; what is found twice is opened once.
    assert finder.asked[3:] == ["details of 192.168.10.21", "details of 10.0.0.5", "details of 23"]
    first = listing.cameras[0]
    assert (first.width, first.height, first.pixel_formats, first.state) == (
        1024,
        768,
        ("Mono8", "BayerRG12p"),
        "free",
    )


def test_what_fails_is_a_note_and_stops_nothing() -> None:
    finder = FakeFinder()
    finder.usb = CaptureError("no USB here")
    finder.details_of = {
        "192.168.10.21": CaptureError("odd GenICam file"),
        "10.0.0.5": Details(is_controlled=True),
    }
    listing = list_connected(finder, ["eth7", "enp3s0"], ["10.0.0.5"])
    assert listing.notes == ("no interface eth7", "no USB here")
    assert [camera.state for camera in listing.cameras] == ["free", "in use", "in use", "free"]
    assert listing.cameras[0].advice == "odd GenICam file"
    assert "/status" in listing.cameras[2].advice


def test_the_table_and_its_json() -> None:
    listing = Listing(cameras=(GIGE, VIDEO), notes=("a note",))
    lines = as_table(listing).splitlines()
    assert lines[0].split() == ["kind", "place", "vendor", "and", "model", "serial", "size", "state"]
    assert lines[1].split() == ["gige", "192.168.10.21", "Maker", "Eye", "4711", "free"]
    assert lines[2].split() == ["v4l2", "/dev/v4l/by-id/usb-web", "Webcam", "640", "x", "480", "free"]
    assert lines[1].index("4711") == lines[0].index("serial")
    assert lines[3].strip() == "YUYV"
    assert lines[-1] == "a note"
    told = json.loads(as_json(listing))
    assert told["cameras"][1]["pixel_formats"] == ["YUYV"]
    assert told["notes"] == ["a note"]
    assert as_table(Listing()) == "No camera found.\n"


@pytest.mark.parametrize(
    ("camera", "name"),
    [(GIGE, "Maker Eye"), (VIDEO, "Webcam"), (Connected(kind="gige", place="10.0.0.5"), "10.0.0.5")],
)
def test_names(camera: Connected, name: str) -> None:
    assert camera.name == name

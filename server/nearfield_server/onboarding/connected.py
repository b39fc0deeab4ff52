"""What is connected to this machine: where the user lets it look, and nowhere else."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Protocol

from nearfield_server.errors import CaptureError

GIGE, USB3, V4L2 = "gige", "usb3", "v4l2"
FREE = "free"
IN_USE = "in use"
NOT_ALLOWED = "not allowed"
OUT_OF_REACH = "out of reach"

HOW_TO_ADD_AN_INTERFACE = (
    "GigE cameras are looked for only where you say: --interface enp3s0 asks all cameras on one network interface, "
    "--address 192.168.10.21 asks one camera."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Connected:
    """A camera that is there.

    Attributes:
        kind: "gige", "usb3" or "v4l2".
        place: how the room file names it: IPv4 address, serial number or stable device path.
        vendor, model, serial: as the maker wrote them; printable.
        interface: network interface, USB device or device node that it was found on.
        width, height: largest picture, pixels; 0 where it does not tell.
        pixel_formats: that it offers.
        format_sizes: largest picture (width, height) in each of them, where that differs; else empty.
        state: "free", "in use" (some program controls it), "not allowed" (for this user) or "out of reach".
        advice: what to do about the state, or about what could not be read.
    """

    kind: str
    place: str
    vendor: str = ""
    model: str = ""
    serial: str = ""
    interface: str = ""
    width: int = 0
    height: int = 0
    pixel_formats: tuple[str, ...] = ()
    format_sizes: tuple[tuple[int, int], ...] = ()
    state: str = FREE
    advice: str = ""

    @property
    def name(self) -> str:
        """For people: vendor and model, or the place where the camera tells neither."""
        return " ".join(filter(None, (self.vendor, self.model))) or self.place

    def size_of(self, pixel_format: str) -> tuple[int, int]:
        """(width, height) of the largest picture in a pixel format; (0, 0) where it does not tell."""
        sizes = dict(zip(self.pixel_formats, self.format_sizes, strict=False))
        return sizes.get(pixel_format, (self.width, self.height))


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """All cameras that were found, and in words why others may be missing."""

    cameras: tuple[Connected, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Details:
    """What an opened camera offers: largest picture, pixel formats, and whether some other program controls it."""

    width: int = 0
    height: int = 0
    pixel_formats: tuple[str, ...] = ()
    is_controlled: bool = False


class Finder(Protocol):
    """Ways to find cameras. All of them raise CaptureError in words."""

    def on_interface(self, interface: str) -> Sequence[Connected]:
        """GigE cameras that answer on one network interface; a broadcast there and only there."""

    def at_address(self, address: str) -> Connected:
        """The GigE camera at an address; no broadcast."""

    def on_usb(self) -> Sequence[Connected]:
        """USB3 Vision cameras."""

    def video(self) -> Sequence[Connected]:
        """V4L2 cameras, with all that they tell."""

    def details(self, camera: Connected) -> Details:
        """Open a GigE or USB3 camera and read what it offers."""


def list_connected(
    finder: Finder,
    interfaces: Sequence[str] = (),
    addresses: Sequence[str] = (),
    *,
    with_details: bool = True,
) -> Listing:
    """Find cameras; what fails becomes a note and stops nothing else.

    Args:
        finder: see there.
        interfaces: network interfaces on which GigE cameras are looked for.
        addresses: GigE cameras that are asked by their address.
        with_details: open cameras that are free to read sizes and pixel formats.
    """
    cameras: dict[tuple[str, str], Connected] = {}
    notes: list[str] = []

    def add(find: Callable[[], Sequence[Connected]]) -> None:
        try:
            for camera in find():
                cameras.setdefault((camera.kind, camera.place), camera)
        except CaptureError as error:
            notes.append(str(error))

    for interface in interfaces:
        add(lambda name=interface: finder.on_interface(name))  # type: ignore[misc]
    for address in addresses:
        add(lambda name=address: [finder.at_address(name)])  # type: ignore[misc]
    add(finder.on_usb)
    add(finder.video)
    if not interfaces and not addresses:
        notes.append(HOW_TO_ADD_AN_INTERFACE)
    found = cameras.values()
    return Listing(
        cameras=tuple(_with_details(finder, camera) if with_details else camera for camera in found),
        notes=tuple(notes),
    )


def _with_details(finder: Finder, camera: Connected) -> Connected:
    if camera.kind == V4L2 or camera.state != FREE:
        return camera
    try:
        details = finder.details(camera)
    except CaptureError as error:
        return replace(camera, advice=str(error))
    return replace(
        camera,
        width=details.width,
        height=details.height,
        pixel_formats=details.pixel_formats,
        state=IN_USE if details.is_controlled else camera.state,
        advice=_IN_USE_ADVICE if details.is_controlled else camera.advice,
    )


_IN_USE_ADVICE = (
    "End the program that controls it. What the cameras of a running service see is on its page /status."
)


def in_use(camera: Connected) -> Connected:
    """The same camera, controlled by some program."""
    return replace(camera, state=IN_USE, advice=_IN_USE_ADVICE)


def as_table(listing: Listing) -> str:
    """One line per camera, its pixel formats below it, then the notes."""
    heads = ("kind", "place", "vendor and model", "serial", "size", "state")
    rows = [
        (
            camera.kind,
            camera.place,
            " ".join(filter(None, (camera.vendor, camera.model))),
            camera.serial,
            f"{camera.width} x {camera.height}" if camera.width else "",
            camera.state,
        )
        for camera in listing.cameras
    ]
    widths = [max(len(row[column]) for row in (heads, *rows)) for column in range(len(heads))]
    lines = []
    if rows:
        lines.append(_line(heads, widths))
    for camera, row in zip(listing.cameras, rows, strict=True):
        lines.append(_line(row, widths))
        lines += [f"      {text}" for text in (" ".join(camera.pixel_formats), camera.advice) if text]
    if not rows:
        lines.append("No camera found.")
    return "\n".join([*lines, *([""] if listing.notes else []), *listing.notes]) + "\n"


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(f"{cell:<{width}}" for cell, width in zip(cells, widths, strict=True)).rstrip()


def as_json(listing: Listing) -> str:
    """The same for programs."""
    return json.dumps(asdict(listing), indent=2) + "\n"

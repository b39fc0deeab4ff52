"""What a GigE Vision or USB3 Vision camera offers. It is opened by its own address or serial: nothing is broadcast, nothing is set."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from nearfield_server.capture.aravis.connection import Connection, open_gige, open_usb
from nearfield_server.capture.aravis.discovery import find_by_serial
from nearfield_server.capture.aravis.library import Aravis, AravisError, load
from nearfield_server.onboarding.connected import Details


def inspect_gige(address: str) -> Details:
    """Read what the camera at an address offers; it is controlled for that moment, if it is free.

    Args:
        address: IPv4 address of the camera.

    Raises:
        CaptureError: libaravis is missing, the camera does not answer, or its description is refused.
    """
    aravis = load()
    with _closing(aravis, open_gige(aravis, address)) as opened:
        return _read(aravis, opened.device, is_controlled=not opened.is_controller)


def inspect_usb(serial: str) -> Details:
    """Read what the USB3 Vision camera with a serial number offers.

    Raises:
        CaptureError: libaravis is missing, there is no such camera, this user may not use it, or its description is refused.
    """
    aravis = load()
    with _closing(aravis, open_usb(aravis, find_by_serial(serial, None))) as opened:
        return _read(aravis, opened.device, is_controlled=False)


@contextlib.contextmanager
def _closing(aravis: Aravis, connection: Connection) -> Iterator[Connection]:
    try:
        yield connection
    finally:
        aravis.unref(connection.device)


def _read(aravis: Aravis, device: int, *, is_controlled: bool) -> Details:
    formats: tuple[str, ...] = ()
    with contextlib.suppress(AravisError):
        formats = aravis.texts(
            lambda count: aravis.c.arv_device_dup_available_enumeration_feature_values_as_strings(
                device, b"PixelFormat", count
            )
        )
    return Details(
        width=_first_integer(aravis, device, b"WidthMax", b"SensorWidth", b"Width"),
        height=_first_integer(aravis, device, b"HeightMax", b"SensorHeight", b"Height"),
        pixel_formats=formats,
        is_controlled=is_controlled,
    )


def _first_integer(aravis: Aravis, device: int, *features: bytes) -> int:
    for feature in features:
        with contextlib.suppress(AravisError):
            value = aravis.c.arv_device_get_integer_feature_value(device, feature)
            if value > 0:
                return value
    return 0

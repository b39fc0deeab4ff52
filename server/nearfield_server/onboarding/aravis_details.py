"""What a GigE Vision or USB3 Vision camera offers. It is opened by its own address or serial: nothing is broadcast, nothing is set."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from nearfield_server.capture.aravis.library import Aravis, AravisError, load
from nearfield_server.errors import CaptureError
from nearfield_server.onboarding.connected import Details


def inspect_gige(address: str, own_address: str) -> Details:
    """Read what the camera at an address offers; it is controlled for that moment, if it is free.

    Args:
        address: IPv4 address of the camera.
        own_address: IPv4 address of this machine on the interface towards it.

    Raises:
        CaptureError: libaravis is missing, or the camera does not answer.
    """
    aravis = load()
    host, camera = (aravis.c.g_inet_address_new_from_string(text.encode()) for text in (own_address, address))
    if host is None or camera is None:
        aravis.unref(host)
        aravis.unref(camera)
        raise CaptureError(
            f"camera {address}: expected IPv4 addresses, found {own_address!r} and {address!r}"
        )
    try:
        device = aravis.c.arv_gv_device_new(host, camera)
    finally:
        aravis.unref(host)
        aravis.unref(camera)
    with _closing(aravis, device, address) as opened:
        return _read(aravis, opened, is_controlled=not aravis.c.arv_gv_device_is_controller(opened))


def inspect_usb(serial: str) -> Details:
    """Read what the USB3 Vision camera with a serial number offers.

    Raises:
        CaptureError: libaravis is missing, there is no such camera, or this user may not use it.
    """
    aravis = load()
    with _closing(aravis, aravis.c.arv_uv_device_new(None, None, serial.encode()), serial) as opened:
        return _read(aravis, opened, is_controlled=False)


@contextlib.contextmanager
def _closing(aravis: Aravis, device: int | None, name: str) -> Iterator[int]:
    if device is None:
        raise CaptureError(f"camera {name}: libaravis cannot open it")
    try:
        yield device
    finally:
        aravis.unref(device)


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

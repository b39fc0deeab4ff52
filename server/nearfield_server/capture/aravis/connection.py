"""The way to one camera: found, judged, opened, and proven to be ours alone to control."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

from nearfield_server.capture.aravis.control_claim import give_up_for_the_dead, write_claim
from nearfield_server.capture.aravis.discovery import find_by_serial
from nearfield_server.capture.aravis.genicam_check import LARGEST_XML_BYTES, check_genicam, fetch_genicam
from nearfield_server.capture.aravis.gvcp import ControlChannel, FoundCamera
from nearfield_server.capture.aravis.library import Aravis, AravisError
from nearfield_server.capture.aravis.own_sockets import udp_ports
from nearfield_server.capture.aravis.release import release_later
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import AravisSourceTable


@dataclass(frozen=True, slots=True, kw_only=True)
class Connection:
    """An opened device.

    Attributes:
        device: the ArvDevice; one reference is owned by whoever holds the connection.
        camera: what it says of itself.
        names: of all nodes of its description.
        ticks_per_s: of its clock; 0 if it has none.
        is_controller: it obeys us; false if another program controls it.
    """

    device: int
    camera: FoundCamera
    names: frozenset[str]
    ticks_per_s: int
    is_controller: bool


def connect(aravis: Aravis, table: AravisSourceTable, where: str) -> Connection:
    """Open a camera by its address, or by its serial.

    Args:
        aravis: the library.
        table: of the room file.
        where: names the camera in messages.

    Raises:
        CaptureError: it does not answer, its description is refused, or another program controls it.
    """
    try:
        camera = None if table.address is not None else find_by_serial(str(table.serial), table.interface)
        if camera is not None and camera.kind == "usb3":
            return open_usb(aravis, camera)
        address = str(table.address) if camera is None else camera.address
        connection = open_gige(aravis, address)
        if not connection.is_controller:
            release_later(aravis, [connection.device])
            raise CaptureError(
                f"another program controls the camera at {address}; end it (the camera gives up a program that died "
                "some seconds after it last heard from it)"
            )
        return connection
    except CaptureError as error:
        raise CaptureError(f"{where}: {error}") from error


def open_gige(aravis: Aravis, address: str) -> Connection:
    """Open the GigE Vision camera at an address; takes control of it if nobody else has it. Only that address is sent anything.

    Raises:
        CaptureError: it does not answer, or its description is refused.
    """
    with ControlChannel(address) as channel:
        camera = channel.describe()
        give_up_for_the_dead(address)
        xml = fetch_genicam(channel)
        names = check_genicam(xml).names
        host_address = channel.host_address
    ports = udp_ports(host_address)
    host = aravis.c.g_inet_address_new_from_string(host_address.encode())
    remote = aravis.c.g_inet_address_new_from_string(address.encode())
    assert host is not None
    assert remote is not None
    try:
        device = aravis.c.arv_gv_device_new(host, remote)
    except AravisError as error:
        raise CaptureError(f"the camera at {address} cannot be opened: {error.reason}") from error
    finally:
        aravis.unref(host)
        aravis.unref(remote)
    if device is None:
        raise CaptureError(f"the camera at {address} cannot be opened: libaravis does not say why")
    if _description(aravis, device) != xml:
        release_later(aravis, [device])
        raise CaptureError(
            f"the camera at {address} described itself in two different ways within a moment; refused"
        )
    try:
        ticks_per_s = aravis.c.arv_gv_device_get_timestamp_tick_frequency(device)
    except AravisError:
        ticks_per_s = 0
    is_controller = aravis.c.arv_gv_device_is_controller(device)
    new_ports = udp_ports(host_address) - ports
    if is_controller and len(new_ports) == 1:
        write_claim(address, host_address, new_ports.pop())
    return Connection(
        device=device, camera=camera, names=names, ticks_per_s=ticks_per_s, is_controller=is_controller
    )


def open_usb(aravis: Aravis, camera: FoundCamera) -> Connection:
    """Open a USB3 Vision camera that `list_usb_cameras` found.

    Raises:
        CaptureError: it cannot be opened, or its description is refused.
    """
    try:
        device = aravis.c.arv_uv_device_new(
            camera.vendor.encode(), camera.model.encode(), camera.serial.encode()
        )
    except AravisError as error:
        raise CaptureError(
            f"USB camera {camera.serial} cannot be opened: {error.reason}; another program may use it"
        ) from error
    if device is None:
        raise CaptureError(f"USB camera {camera.serial} cannot be opened: libaravis does not say why")
    try:
        names = check_genicam(_description(aravis, device)).names
    except CaptureError:
        release_later(aravis, [device])
        raise
    return Connection(
        device=device, camera=camera, names=names, ticks_per_s=1_000_000_000, is_controller=True
    )


def _description(aravis: Aravis, device: int) -> bytes:
    size = ctypes.c_size_t(0)
    address = aravis.c.arv_device_get_genicam_xml(device, ctypes.byref(size))
    if address is None or size.value > LARGEST_XML_BYTES:
        raise CaptureError(f"expected a description of at most {LARGEST_XML_BYTES} bytes, found {size.value}")
    return ctypes.string_at(address, size.value)

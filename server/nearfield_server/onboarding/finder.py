"""The ways in which cameras are really found; `connected.list_connected` puts them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from nearfield_server.capture.aravis.discovery import list_cameras as list_gige_cameras
from nearfield_server.capture.aravis.discovery import list_usb_cameras
from nearfield_server.capture.aravis.gvcp import FoundCamera
from nearfield_server.capture.v4l2.discovery import FoundCamera as VideoCamera
from nearfield_server.capture.v4l2.discovery import list_cameras as list_video_cameras
from nearfield_server.errors import CaptureError
from nearfield_server.onboarding.aravis_details import inspect_gige, inspect_usb
from nearfield_server.onboarding.connected import (
    FREE,
    GIGE,
    NOT_ALLOWED,
    OUT_OF_REACH,
    USB3,
    V4L2,
    Connected,
    Details,
    in_use,
)
from nearfield_server.onboarding.gige import AnsweringCamera, ask_camera


class ThisMachinesFinder:
    """Finds the cameras of this machine; see `connected.Finder`."""

    def on_interface(self, interface: str) -> Sequence[Connected]:
        """See `Finder`."""
        return [self._asked(camera, interface) for camera in list_gige_cameras(interface)]

    def _asked(self, camera: FoundCamera, interface: str) -> Connected:
        if camera.is_reachable:
            try:
                return from_answer(ask_camera(camera.address), interface)
            except CaptureError as error:
                return replace(from_gige(camera, interface), advice=str(error))
        return from_gige(camera, interface)

    def at_address(self, address: str) -> Connected:
        """See `Finder`."""
        return from_answer(ask_camera(address))

    def on_usb(self) -> Sequence[Connected]:
        """See `Finder`."""
        return [from_usb(camera) for camera in list_usb_cameras()]

    def video(self) -> Sequence[Connected]:
        """See `Finder`."""
        return [from_video(camera) for camera in list_video_cameras()]

    def details(self, camera: Connected) -> Details:
        """See `Finder`."""
        if camera.kind == USB3:
            return inspect_usb(camera.place)
        return inspect_gige(camera.place)


def from_gige(camera: FoundCamera, interface: str = "") -> Connected:
    """A GigE camera that answered."""
    return Connected(
        kind=GIGE,
        place=camera.address,
        vendor=camera.vendor,
        model=camera.model,
        serial=camera.serial,
        interface=interface or camera.interface,
        state=FREE if camera.is_reachable else OUT_OF_REACH,
        advice=camera.advice,
    )


def from_answer(answer: AnsweringCamera, interface: str = "") -> Connected:
    """A GigE camera that was asked whether it is free."""
    camera = from_gige(answer.camera, interface)
    return in_use(camera) if answer.is_controlled else camera


def from_usb(camera: FoundCamera) -> Connected:
    """A USB3 Vision camera."""
    return Connected(
        kind=USB3,
        place=camera.serial,
        vendor=camera.vendor,
        model=camera.model,
        serial=camera.serial,
        interface=camera.interface,
        state=FREE if camera.is_reachable else NOT_ALLOWED,
        advice=camera.advice,
    )


def from_video(camera: VideoCamera) -> Connected:
    """A V4L2 camera. Several programs may open one, but only one may stream; that shows when it is opened."""
    sizes: dict[str, tuple[int, int]] = {}
    for choice in camera.formats:
        offered = [sizes.get(choice.name, (0, 0)), *(size.greatest for size in choice.sizes)]
        sizes[choice.name] = max(offered, key=lambda size: size[0] * size[1])
    width, height = max(sizes.values(), key=lambda size: size[0] * size[1], default=(0, 0))
    return Connected(
        kind=V4L2,
        place=camera.path,
        model=camera.card,
        serial=camera.serial,
        interface=camera.node,
        width=width,
        height=height,
        pixel_formats=tuple(sizes),
        format_sizes=tuple(sizes.values()),
        state=NOT_ALLOWED if camera.problem else FREE,
        advice=camera.problem,
    )

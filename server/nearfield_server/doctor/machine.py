"""The machine as the checks see it. Checks ask nothing else, so tests can give them any machine."""

from __future__ import annotations

import contextlib
import ctypes
import glob
import grp
import importlib.metadata
import os
import pwd
import shutil
import socket
import sys
from pathlib import Path
from typing import Protocol

from nearfield_server.capture.aravis.receive_buffer import can_open_packet_sockets
from nearfield_server.capture.v4l2.discovery import inspect_camera
from nearfield_server.onboarding.aravis_details import inspect_gige, inspect_usb
from nearfield_server.onboarding.gige import AnsweringCamera, ask_camera
from nearfield_server.scene.device_schema import DeviceSourceTable, V4l2SourceTable

_DISTRIBUTION = "nearfield"
_READ_BYTES = 1 << 20
_STA_UNSYNC = 0x0040
_TIME_ERROR = 5


class Machine(Protocol):
    """Questions to the operating system. None of them changes anything, and none broadcasts."""

    def read(self, path: str) -> str | None:
        """Text of a small file, stripped; None if it is missing or may not be read."""

    def names(self, pattern: str) -> tuple[str, ...]:
        """Paths that match a pattern, sorted."""

    def may_use(self, path: str) -> bool:
        """Whether this user may read and write a path."""

    def num_processors(self) -> int:
        """How many processors this program may use."""

    def python_version(self) -> str:
        """As "3.11.7"."""

    def requirements(self) -> tuple[str, ...]:
        """Packages that Nearfield needs, as in its metadata ("numpy<3,>=2.2")."""

    def package_version(self, name: str) -> str | None:
        """Installed version of a package; None if it is missing."""

    def user(self) -> str:
        """Name of this user."""

    def groups(self) -> frozenset[str]:
        """Groups of this process."""

    def can_open_packet_socket(self) -> bool:
        """Whether packets may be read below the IP layer (CAP_NET_RAW)."""

    def free_bytes(self, path: Path) -> int | None:
        """Free space of the file system that a path would be on."""

    def why_taken(self, host: str, port: int) -> str:
        """Why a TCP port cannot be listened on; empty if it can."""

    def renderer(self) -> tuple[str, bool]:
        """Name of the OpenGL renderer, and whether it is a software renderer.

        Raises:
            GraphicsError: there is none.
        """

    def aravis_version(self) -> str:
        """Version of libaravis.

        Raises:
            CaptureError: it is not installed.
        """

    def clock_is_synchronised(self) -> bool | None:
        """Whether the kernel says that the clock follows another one; None if it does not say."""

    def ask_gige(self, address: str) -> AnsweringCamera:
        """Ask one camera at its address; see `onboarding.gige.ask_camera`."""

    def pixel_formats(self, source: DeviceSourceTable) -> tuple[str, ...]:
        """Pixel formats of a camera that is free; empty where it does not tell.

        Raises:
            CaptureError: it cannot be opened.
        """


class ThisMachine:
    """The machine that this runs on (Linux)."""

    def read(self, path: str) -> str | None:
        """See `Machine`."""
        try:
            with open(path, encoding="utf-8", errors="replace") as file:
                return file.read(_READ_BYTES).strip()
        except OSError:
            return None

    def names(self, pattern: str) -> tuple[str, ...]:
        """See `Machine`."""
        return tuple(sorted(glob.glob(pattern)))

    def may_use(self, path: str) -> bool:
        """See `Machine`."""
        return os.access(path, os.R_OK | os.W_OK)

    def num_processors(self) -> int:
        """See `Machine`."""
        return len(os.sched_getaffinity(0))

    def python_version(self) -> str:
        """See `Machine`."""
        return ".".join(map(str, sys.version_info[:3]))

    def requirements(self) -> tuple[str, ...]:
        """See `Machine`."""
        try:
            lines = importlib.metadata.requires(_DISTRIBUTION) or []
        except importlib.metadata.PackageNotFoundError:
            return ()
        return tuple(line for line in lines if "extra ==" not in line)

    def package_version(self, name: str) -> str | None:
        """See `Machine`."""
        try:
            return importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            return None

    def user(self) -> str:
        """See `Machine`."""
        try:
            return pwd.getpwuid(os.getuid()).pw_name
        except KeyError:
            return str(os.getuid())

    def groups(self) -> frozenset[str]:
        """See `Machine`."""
        found = set()
        for number in {*os.getgroups(), os.getegid()}:
            with contextlib.suppress(KeyError):
                found.add(grp.getgrgid(number).gr_name)
        return frozenset(found)

    def can_open_packet_socket(self) -> bool:
        """See `Machine`."""
        return can_open_packet_sockets()

    def free_bytes(self, path: Path) -> int | None:
        """See `Machine`."""
        path = path.absolute()
        existing = next((folder for folder in (path, *path.parents) if folder.exists()), None)
        if existing is None:
            return None
        try:
            return shutil.disk_usage(existing).free
        except OSError:
            return None

    def why_taken(self, host: str, port: int) -> str:
        """See `Machine`."""
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind((host, port))
                probe.listen(1)
        except OSError as error:
            return str(error.strerror)
        return ""

    def renderer(self) -> tuple[str, bool]:
        """See `Machine`."""
        from nearfield_server.gpu.context import open_context

        with open_context() as context:
            return context.renderer, context.is_software

    def aravis_version(self) -> str:
        """See `Machine`."""
        from nearfield_server.capture.aravis.library import load

        return ".".join(map(str, load().version))

    def clock_is_synchronised(self) -> bool | None:
        """See `Machine`."""
        # struct timex, as words: modes (0 = only read), offset, freq, maxerror, esterror, status. Larger than any kernel's.
        fields = (ctypes.c_long * 64)()
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(fields))
        if state < 0:
            return None
        return state != _TIME_ERROR and not int(fields[5]) & _STA_UNSYNC

    def ask_gige(self, address: str) -> AnsweringCamera:
        """See `Machine`."""
        return ask_camera(address)

    def pixel_formats(self, source: DeviceSourceTable) -> tuple[str, ...]:
        """See `Machine`."""
        if isinstance(source, V4l2SourceTable):
            camera = inspect_camera(source.path)
            return () if camera is None else tuple(choice.name for choice in camera.formats)
        if source.address is None:
            return inspect_usb(str(source.serial)).pixel_formats
        return inspect_gige(str(source.address)).pixel_formats

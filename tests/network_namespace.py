"""The tests run in a network of their own: only loopback. Simulated cameras may answer whoever asks, and nothing is heard outside.

Entered once, when pytest starts and has one thread: threads and processes made afterwards are inside, whatever library makes them.
Root needs nothing else; an ordinary user becomes root of a user namespace. Mounts are private too, so that tests can fill a small disk.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import socket
import struct
import subprocess
from pathlib import Path
from typing import Final

OFF: Final = "NEARFIELD_TESTS_OUTSIDE"
"""Set to 1 to stay on the machine's network, to look into a running test from outside; tests of cameras are then skipped."""
_INSIDE: Final = "NEARFIELD_TESTS_NAMESPACE"
_MOUNTS: Final = "NEARFIELD_TESTS_MOUNTS"
_CLONE_NEWNS, _CLONE_NEWUSER, _CLONE_NEWNET = 0x00020000, 0x10000000, 0x40000000
_MS_REC, _MS_PRIVATE = 0x4000, 1 << 18
_SIOCGIFFLAGS, _SIOCSIFFLAGS, _IFF_UP = 0x8913, 0x8914, 0x1


def enter() -> None:
    """Move this process into namespaces of its own; sets what `why_not` tells if that cannot be done.

    Workers of pytest-xdist are children of a process that is inside, and stay where they are.
    """
    if _INSIDE in os.environ:
        return
    os.environ[_INSIDE] = _try_to_enter()
    os.environ[_MOUNTS] = os.environ[_INSIDE] or _make_mounts_private()


def why_not() -> str:
    """Why there is no namespace, in words; empty if there is one."""
    return os.environ.get(_INSIDE, "the namespace was not asked for")


def why_no_mounts() -> str:
    """Why tests must not mount anything, in words; empty if what they mount is theirs alone."""
    return os.environ.get(_MOUNTS, "the namespace was not asked for")


def camera_address(index: int) -> str:
    """An address of loopback for camera `index` (0 to 99) of this worker of pytest, put on the interface if it is not there yet.

    GigE Vision has one fixed port, so that every camera needs an address of its own.
    """
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    address = f"127.0.{worker + 1}.{index + 10}"
    ip = shutil.which("ip") or "/usr/sbin/ip"
    subprocess.run([ip, "address", "replace", f"{address}/8", "dev", "lo"], check=True, timeout=60)
    return address


def _try_to_enter() -> str:
    if os.environ.get(OFF) == "1":
        return f"{OFF}=1 keeps the tests on the machine's network"
    uid, gid = os.getuid(), os.getgid()
    error = _unshare(_CLONE_NEWNET | _CLONE_NEWNS)
    if error:
        error = _unshare(_CLONE_NEWUSER | _CLONE_NEWNET | _CLONE_NEWNS)
        if error:
            return (
                f"this system lets neither root nor user {uid} make a network namespace ({error}); "
                "run as root or allow it: sysctl kernel.unprivileged_userns_clone=1"
            )
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"0 {uid} 1")
        Path("/proc/self/gid_map").write_text(f"0 {gid} 1")
    _set_up("lo")
    return ""


def _make_mounts_private() -> str:
    """Reason of the system, empty on success."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mount(b"none", b"/", None, _MS_REC | _MS_PRIVATE, None) == 0:
        return ""
    # In a plain chroot, for one, whose root is no mount.
    return f"mounts cannot be made private: {os.strerror(ctypes.get_errno())}"


def _unshare(flags: int) -> str:
    """Reason of the system, empty on success."""
    if ctypes.CDLL(None, use_errno=True).unshare(flags) == 0:
        return ""
    return os.strerror(ctypes.get_errno())


def _set_up(interface: str) -> None:
    """Switch a network interface on, which also gives loopback its 127.0.0.1."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sh14x", interface.encode(), 0)
        flags = struct.unpack("16sh14x", fcntl.ioctl(any_socket, _SIOCGIFFLAGS, request))[1]
        fcntl.ioctl(any_socket, _SIOCSIFFLAGS, struct.pack("16sh14x", interface.encode(), flags | _IFF_UP))

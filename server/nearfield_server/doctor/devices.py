"""May this user talk to video devices and USB cameras?"""

from __future__ import annotations

from pathlib import PurePosixPath

from nearfield_server.doctor.finding import Finding, ok, problem, warning
from nearfield_server.doctor.machine import Machine

UDEV_RULE_FILE = "/etc/udev/rules.d/70-nearfield-cameras.rules"
USBFS_MEMORY = "/sys/module/usbcore/parameters/usbfs_memory_mb"
USBFS_NEEDED_MB = 256
# Interface class of USB3 Vision: miscellaneous device, subclass 5, protocol 0 (control).
_USB3_VISION = ("ef", "05")


def check_video(machine: Machine, paths: tuple[str, ...] = ()) -> Finding:
    """V4L2 devices are there and may be used.

    Args:
        machine: see there.
        paths: devices that the room names; they are told by `room_cameras`, here they only make devices necessary.
    """
    nodes = machine.names("/dev/video*")
    if not nodes:
        if paths:
            return problem(
                "video",
                "no /dev/video*: no V4L2 camera is connected",
                "sudo dmesg | tail   # after replugging",
            )
        return ok("video", "no V4L2 camera is connected")
    forbidden = [node for node in nodes if not machine.may_use(node)]
    if not forbidden:
        return ok("video", f"{', '.join(nodes)}: this user may use them")
    group = f"sudo usermod -aG video {machine.user()}   # then log in again"
    if "video" in machine.groups():
        group = f"sudo chgrp video {' '.join(forbidden)} && sudo chmod g+rw {' '.join(forbidden)}"
    text = f"{', '.join(forbidden)}: this user may not use {'it' if len(forbidden) == 1 else 'them'}"
    return (problem if paths else warning)("video", text, group)


def check_usb(machine: Machine) -> Finding:
    """USB3 Vision cameras may be used, and the kernel lets them queue enough memory."""
    cameras = find_usb_cameras(machine)
    if not cameras:
        return ok("usb", "no USB3 Vision camera is connected")
    forbidden = [(vendor, node) for vendor, node in cameras if not machine.may_use(node)]
    if forbidden:
        rules = "\\n".join(udev_rule(vendor) for vendor in sorted({vendor for vendor, _ in forbidden}))
        return problem(
            "usb",
            f"{', '.join(node for _, node in forbidden)}: this user may not use the camera",
            f"printf '{rules}\\n' | sudo tee {UDEV_RULE_FILE} && sudo udevadm control --reload && sudo udevadm trigger",
        )
    limit = machine.read(USBFS_MEMORY)
    if limit is not None and limit.isdecimal() and 0 < int(limit) < USBFS_NEEDED_MB:
        return warning(
            "usb",
            f"USB transfers of all cameras share {limit} MB, expected {USBFS_NEEDED_MB} MB: frames will be lost",
            f"echo {USBFS_NEEDED_MB} | sudo tee {USBFS_MEMORY}   # kernel command line: usbcore.usbfs_memory_mb={USBFS_NEEDED_MB}",
        )
    return ok(
        "usb", f"{len(cameras)} USB3 Vision {'camera' if len(cameras) == 1 else 'cameras'}, may be used"
    )


def find_usb_cameras(machine: Machine) -> list[tuple[str, str]]:
    """(vendor id, device node) of every connected USB3 Vision camera, from sysfs."""
    found = set()
    for path in machine.names("/sys/bus/usb/devices/*/bInterfaceClass"):
        interface = PurePosixPath(path).parent
        if (machine.read(path), machine.read(f"{interface}/bInterfaceSubClass")) != _USB3_VISION:
            continue
        # An interface is named "<device>:<configuration>.<number>".
        device = f"{interface.parent}/{interface.name.split(':')[0]}"
        vendor, bus, number = (machine.read(f"{device}/{name}") for name in ("idVendor", "busnum", "devnum"))
        if vendor and bus and number:
            found.add((vendor, f"/dev/bus/usb/{int(bus):03d}/{int(number):03d}"))
    return sorted(found)


def udev_rule(vendor: str) -> str:
    """Rule that lets the user at the screen and the group `video` use all devices of a maker."""
    return f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vendor}", MODE="0660", GROUP="video", TAG+="uaccess"'

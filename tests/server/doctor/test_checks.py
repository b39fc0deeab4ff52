"""Every outcome of every check, on machines made up for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from nearfield_server.doctor import devices, network, software, system
from nearfield_server.doctor.finding import Finding, Level
from nearfield_server.doctor.network import GigeStream
from nearfield_server.errors import CaptureError, GraphicsError

from .conftest import FakeMachine

OK, WARNING, PROBLEM = Level.OK, Level.WARNING, Level.PROBLEM


def expect(finding: Finding, level: Level, *words: str) -> None:
    """Level and words; whatever is not well says what to do, and what is well asks for nothing."""
    assert finding.level is level, finding
    for word in words:
        assert word in finding.text + finding.mend, finding
    assert bool(finding.mend) == (level is not OK), finding


def stream(address: str = "192.168.10.21", payload: int = 1_572_864, rate: float = 10.0) -> GigeStream:
    return GigeStream(camera_id="cam0", address=address, payload=payload, frame_rate=rate)


# Software


def test_python(machine: FakeMachine) -> None:
    expect(software.check_python(machine), OK, "3.11.7")
    machine.python = "3.10.12"
    expect(software.check_python(machine), PROBLEM, "3.10.12", "3.11", "apt-get install python3.11")


def test_packages(machine: FakeMachine) -> None:
    expect(software.check_packages(machine), OK, "2 packages")
    machine.packages = {"numpy": "3.0.1"}
    expect(
        software.check_packages(machine),
        PROBLEM,
        "numpy 3.0.1",
        "fastapi missing",
        "pip install 'numpy<3,>=2.2' 'fastapi",
    )
    machine.needed = ()
    expect(software.check_packages(machine), PROBLEM, "not installed", "make setup")


@pytest.mark.parametrize(
    ("version", "bounds", "holds"),
    [
        ("2.2", ">=2.2,<3", True),
        ("2.10.0", ">=2.2,<3", True),
        ("2.1.9", ">=2.2,<3", False),
        ("3", "<3", False),
        ("3.0.0rc1", "<3", False),
        ("1.0", "==1.0.0", True),
        ("1.0.1", "!=1.0.1", False),
        ("1.4.7", "~=1.4.2", True),
        ("1.5.0", "~=1.4.2", False),
        ("2.0", ">2", False),
        ("2.0", "<=2", True),
        ("2026.1", "", True),
    ],
)
def test_versions(version: str, bounds: str, holds: bool) -> None:
    assert software.is_within(version, bounds) is holds


@pytest.mark.parametrize(
    ("line", "name", "bounds"),
    [
        ("numpy<3,>=2.2", "numpy", "<3,>=2.2"),
        ("uvicorn[standard] (>=0.40) ; python_version > '3'", "uvicorn", ">=0.40"),
        ("eclipse-zenoh", "eclipse-zenoh", ""),
    ],
)
def test_requirements(line: str, name: str, bounds: str) -> None:
    assert software.parse_requirement(line) == (name, bounds)


def test_aravis(machine: FakeMachine) -> None:
    expect(software.check_aravis(machine, True), OK, "0.8.26")
    machine.aravis = "0.8.2"
    expect(software.check_aravis(machine, True), WARNING, "0.8.2")
    machine.aravis = CaptureError("no library")
    expect(software.check_aravis(machine, False), WARNING, "only V4L2", "apt-get install")
    expect(software.check_aravis(machine, True), PROBLEM, "no library", "libaravis-0.8-0")


def test_graphics(machine: FakeMachine) -> None:
    expect(software.check_graphics(machine), OK, "NVIDIA")
    machine.gl = ("llvmpipe (LLVM 19)", True)
    expect(software.check_graphics(machine), WARNING, "llvmpipe", "software renderer")
    machine.files["/dev/dri/renderD128"] = ""
    expect(software.check_graphics(machine), WARNING, "install the driver")
    machine.forbidden.add("/dev/dri/renderD128")
    expect(software.check_graphics(machine), WARNING, "usermod -aG render ada")
    machine.gl = GraphicsError("no EGL")
    expect(software.check_graphics(machine), WARNING, "no EGL", "libegl1")


def test_page(tmp_path: Path) -> None:
    expect(software.check_page(tmp_path), PROBLEM, "make setup")
    (tmp_path / "index.html").touch()
    expect(software.check_page(tmp_path), OK, "WebGL 2", "certificate")


# Devices


def test_video_devices(machine: FakeMachine) -> None:
    expect(devices.check_video(machine), OK, "no V4L2 camera")
    expect(devices.check_video(machine, ("/dev/video0",)), PROBLEM, "no /dev/video*")
    machine.files["/dev/video0"] = ""
    expect(devices.check_video(machine), OK, "/dev/video0")
    machine.forbidden.add("/dev/video0")
    expect(devices.check_video(machine), WARNING, "usermod -aG video ada")
    expect(devices.check_video(machine, ("/dev/video0",)), PROBLEM, "usermod -aG video ada")
    machine.member_of = frozenset({"video"})
    expect(devices.check_video(machine), WARNING, "chgrp video /dev/video0")


def _plug_in(machine: FakeMachine, interface_class: str = "ef", subclass: str = "05") -> None:
    device = "/sys/bus/usb/devices/2-1"
    for number, (kind, sub) in enumerate([(interface_class, subclass), ("ff", "00")]):
        machine.files[f"{device}:1.{number}/bInterfaceClass"] = kind
        machine.files[f"{device}:1.{number}/bInterfaceSubClass"] = sub
    machine.files |= {f"{device}/idVendor": "1ab2", f"{device}/busnum": "2", f"{device}/devnum": "17"}


def test_usb_cameras(machine: FakeMachine) -> None:
    expect(devices.check_usb(machine), OK, "no USB3 Vision")
    _plug_in(machine, "08", "06")  # a memory stick
    expect(devices.check_usb(machine), OK, "no USB3 Vision")
    _plug_in(machine)
    assert devices.find_usb_cameras(machine) == [("1ab2", "/dev/bus/usb/002/017")]
    expect(devices.check_usb(machine), OK, "1 USB3 Vision camera")
    machine.files[devices.USBFS_MEMORY] = "16"
    expect(devices.check_usb(machine), WARNING, "16 MB", "usbfs_memory_mb=256")
    machine.files[devices.USBFS_MEMORY] = "0"  # no limit
    expect(devices.check_usb(machine), OK)
    machine.forbidden.add("/dev/bus/usb/002/017")
    expect(devices.check_usb(machine), PROBLEM, "/dev/bus/usb/002/017", devices.udev_rule("1ab2"), "udevadm")


# Network


def test_packet_socket(machine: FakeMachine) -> None:
    expect(network.check_packet_socket(machine), OK)
    machine.packet_socket = False
    expect(network.check_packet_socket(machine), WARNING, "CAP_NET_RAW", "setcap cap_net_raw")


@pytest.mark.parametrize(
    ("limit", "packet_socket", "level"),
    [
        (3 * 1_572_864, False, OK),
        (3 * 1_572_864 - 1, False, WARNING),
        (2 * 1_572_864, False, WARNING),
        (2 * 1_572_864 - 1, False, PROBLEM),
        (212_992, False, PROBLEM),
        (212_992, True, OK),
    ],
)
def test_receive_buffer_holds_the_largest_frame_three_times(
    machine: FakeMachine, limit: int, packet_socket: bool, level: Level
) -> None:
    machine.files[network.RMEM_MAX], machine.packet_socket = str(limit), packet_socket
    small = GigeStream(camera_id="cam1", address="192.168.10.22", payload=1000, frame_rate=10)
    finding = network.check_receive_buffer(machine, [stream(), small])
    expect(finding, level)
    if level is not OK:
        assert f"net.core.rmem_max = {3 * 1_572_864}" in finding.mend


def test_receive_buffer_without_cameras_or_proc(machine: FakeMachine) -> None:
    machine.files[network.RMEM_MAX] = "212992"
    expect(network.check_receive_buffer(machine, []), OK, "no GigE camera")
    del machine.files[network.RMEM_MAX]
    expect(network.check_receive_buffer(machine, [stream()]), WARNING, "cannot be read")


def _about(findings: list[Finding], check: str) -> Finding:
    return next(finding for finding in findings if finding.check == check)


def test_a_good_link(machine: FakeMachine) -> None:
    findings = network.check_interfaces(machine, [stream()])
    assert [finding.check for finding in findings] == [
        "link enp3s0",
        "packets enp3s0",
        "source check enp3s0",
        "firewall",
    ]
    for finding in findings:
        expect(finding, OK)
    assert "126 Mbit/s from cam0 over 1,000 Mbit/s" in findings[0].text
    assert network.check_interfaces(machine, []) == []


def test_links_that_do_not_carry_the_cameras(machine: FakeMachine) -> None:
    streams = [stream(rate=rate) for rate in (30.0, 45.0)]
    # 8 * 1572864 * 75 / 1e6 = 943.7 of 900 usable.
    finding = _about(network.check_interfaces(machine, streams), "link enp3s0")
    expect(finding, PROBLEM, "944 Mbit/s", "frame_rate to 0.95")
    machine.files["/sys/class/net/enp3s0/speed"] = "10000"
    expect(_about(network.check_interfaces(machine, streams), "link enp3s0"), OK)
    machine.files["/sys/class/net/enp3s0/speed"] = "100"
    slow = [stream(rate=1.0)]
    expect(_about(network.check_interfaces(machine, slow), "link enp3s0"), WARNING, "cable")
    machine.files["/sys/class/net/enp3s0/speed"] = "-1"  # what virtual interfaces say
    expect(_about(network.check_interfaces(machine, slow), "link enp3s0"), OK)
    machine.files["/sys/class/net/enp3s0/operstate"] = "down"
    expect(_about(network.check_interfaces(machine, slow), "link enp3s0"), PROBLEM, "ip link set enp3s0 up")


def test_packet_sizes(machine: FakeMachine) -> None:
    machine.files["/sys/class/net/enp3s0/mtu"] = "1500"
    finding = _about(network.check_interfaces(machine, [stream()]), "packets enp3s0")
    expect(finding, WARNING, "1,500 bytes", "ip link set dev enp3s0 mtu 9000")
    del machine.files["/sys/class/net/enp3s0/mtu"]
    expect(_about(network.check_interfaces(machine, [stream()]), "packets enp3s0"), WARNING, "cannot be read")


def test_cameras_in_a_network_that_this_machine_is_not_in(machine: FakeMachine) -> None:
    machine.files["/sys/class/net/enp3s0/address"] = ""
    machine.files["/sys/class/net/enp3s0"] = ""
    (finding,) = network.check_interfaces(machine, [stream("10.0.0.1")])
    expect(finding, PROBLEM, "router behind enp1s0")
    assert finding.mend.startswith("sudo ip addr add 10.0.0.2/24 dev enp3s0")
    machine.files["/proc/net/route"] = ""
    (finding,) = network.check_interfaces(machine, [stream()])
    expect(finding, PROBLEM, "no interface leads there", "192.168.10.1/24")


def test_loopback_is_no_link(machine: FakeMachine) -> None:
    findings = network.check_interfaces(machine, [stream("127.0.0.3")])
    assert [(finding.check, finding.level) for finding in findings] == [("link lo", OK), ("firewall", OK)]


def test_the_most_specific_route_wins(machine: FakeMachine) -> None:
    machine.files["/proc/net/route"] += "enp9s0\t150AA8C0\t00000000\t0005\t0\t0\t0\tFFFFFFFF\t0\t0\t0\n"
    assert network.interface_towards(machine, "192.168.10.21") == ("enp9s0", True)
    assert network.interface_towards(machine, "192.168.10.22") == ("enp3s0", True)
    assert network.interface_towards(machine, "8.8.8.8") == ("enp1s0", False)


def test_a_strict_source_check_with_two_interfaces_in_one_network(machine: FakeMachine) -> None:
    conf = "/proc/sys/net/ipv4/conf"
    machine.files[f"{conf}/all/rp_filter"] = "1"
    machine.files[f"{conf}/enp3s0/rp_filter"] = "0"
    expect(_about(network.check_interfaces(machine, [stream()]), "source check enp3s0"), OK)
    machine.files["/proc/net/route"] += "wlan0\t000AA8C0\t00000000\t0001\t0\t0\t600\t00FFFFFF\t0\t0\t0\n"
    finding = _about(network.check_interfaces(machine, [stream()]), "source check enp3s0")
    expect(finding, WARNING, "wlan0", "net.ipv4.conf.enp3s0.rp_filter=2")
    machine.files[f"{conf}/enp3s0/rp_filter"] = "2"
    expect(_about(network.check_interfaces(machine, [stream()]), "source check enp3s0"), OK)


def test_a_camera_found_by_its_serial_uses_the_interface_that_the_room_names(machine: FakeMachine) -> None:
    by_serial = GigeStream(camera_id="cam1", address="", payload=1000, frame_rate=10, interface="enp1s0")
    findings = network.check_interfaces(machine, [by_serial])
    expect(_about(findings, "link enp1s0"), OK, "cam1")
    expect(_about(findings, "packets enp1s0"), WARNING, "ip link set dev enp1s0 mtu 9000")


def test_firewalls(machine: FakeMachine) -> None:
    machine.files["/etc/ufw/ufw.conf"] = "# on\nENABLED=no"
    expect(network.check_firewall(machine, ["enp3s0"]), OK)
    machine.files["/etc/ufw/ufw.conf"] = "# on\nENABLED=yes"
    expect(network.check_firewall(machine, ["enp3s0"]), WARNING, "ufw allow in on enp3s0 proto udp")
    machine.files.pop("/etc/ufw/ufw.conf")
    machine.files["/run/firewalld"] = ""
    expect(network.check_firewall(machine, ["enp3s0"]), WARNING, "firewall-cmd", "--change-interface=enp3s0")


def test_ports(machine: FakeMachine) -> None:
    for finding in network.check_ports(machine, 8080):
        expect(finding, OK)
    machine.taken = {8080: "Address already in use", 0: "Cannot assign requested address"}
    page, bus = network.check_ports(machine, 8080)
    expect(page, WARNING, "already in use", "ss -ltnp 'sport = :8080'", "--port 8081")
    expect(bus, PROBLEM, "ip link set lo up")


# System


def test_memory(machine: FakeMachine) -> None:
    expect(system.check_memory(machine, 1 << 30, 4), OK, "16.0 GiB free")
    expect(system.check_memory(machine, 16 << 30, 4), PROBLEM)
    machine.files |= {
        "/sys/fs/cgroup/memory.max": str(2 << 30),
        "/sys/fs/cgroup/memory.current": str(1 << 30),
    }
    expect(system.check_memory(machine, 0, 3), PROBLEM, "1.0 GiB free")
    machine.files["/sys/fs/cgroup/memory.max"] = "max"
    expect(system.check_memory(machine, 0, 3), OK)
    machine.files["/proc/meminfo"] = "MemTotal: 1 kB"
    expect(system.check_memory(machine, 0, 3), WARNING, "/proc/meminfo")


@pytest.mark.parametrize(
    ("free", "bytes_per_s", "level", "word"),
    [
        (500 << 30, 0.0, OK, "500.0 GiB"),
        (600 * 10**9, 1e8, OK, "100 minutes at 100 MB/s"),
        (59 * 10**9, 1e8, WARNING, "10 minutes"),
        (1 << 30, 0.0, PROBLEM, "at least 2 GiB"),
        (None, 1e8, WARNING, "cannot be read"),
    ],
)
def test_disk(machine: FakeMachine, free: int | None, bytes_per_s: float, level: Level, word: str) -> None:
    machine.free = free
    expect(system.check_disk(machine, Path("/records"), bytes_per_s), level, word, "/records")


def test_clock(machine: FakeMachine) -> None:
    expect(system.check_clock(machine), OK, "synchronised")
    machine.synchronised = None
    expect(system.check_clock(machine), OK, "does not tell")
    machine.synchronised = False
    expect(system.check_clock(machine), WARNING, "chrony")
    machine.synchronised = True
    expect(system.check_clock(machine, uses_ptp=True), WARNING, "ptp4l")
    machine.files["/proc/812/comm"] = "ptp4l"
    expect(system.check_clock(machine, uses_ptp=True), OK)


def test_processor(machine: FakeMachine) -> None:
    expect(system.check_processor(machine), OK, "4 cores")  # flags are named otherwise, or not at all
    machine.files["/proc/cpuinfo"] = "processor\t: 0\nflags\t\t: fpu avx2 f16c fma\n"
    expect(system.check_processor(machine), OK, "4 cores")
    machine.processors = 1
    expect(system.check_processor(machine), WARNING, "1 core:", "two cores")
    machine.files["/proc/cpuinfo"] = "processor\t: 0\nflags\t\t: fpu sse4_2 f16\n"
    expect(system.check_processor(machine), PROBLEM, "without F16C", "-cpu host")


def test_governor(machine: FakeMachine) -> None:
    expect(system.check_governor(machine), OK, "not governed")
    for number, governor in enumerate(["performance", "powersave"]):
        machine.files[f"/sys/devices/system/cpu/cpu{number}/cpufreq/scaling_governor"] = governor
    expect(
        system.check_governor(machine), WARNING, "performance, powersave", "tee /sys/devices/system/cpu/cpu*"
    )
    machine.files["/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor"] = "performance"
    expect(system.check_governor(machine), OK)

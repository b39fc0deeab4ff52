"""Memory, disk, clock, processor."""

from __future__ import annotations

from pathlib import Path

from nearfield_server.doctor.finding import Finding, ok, problem, warning
from nearfield_server.doctor.machine import Machine

_WARN_MINUTES = 10.0
_LEAST_FREE = 2 << 30
_PROCESS_BYTES = 400 << 20
_GOVERNORS = "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"


def check_memory(machine: Machine, ring_bytes: int, num_processes: int) -> Finding:
    """Frame rings and processes fit into the memory of the machine, or of the container that this runs in.

    Args:
        machine: see there.
        ring_bytes: shared memory of all frame rings.
        num_processes: that the service will start.
    """
    available = _kilobytes(machine.read("/proc/meminfo") or "", "MemAvailable")
    if available is None:
        return warning("memory", "/proc/meminfo cannot be read", "check that /proc is mounted")
    limit = machine.read("/sys/fs/cgroup/memory.max")
    used = machine.read("/sys/fs/cgroup/memory.current")
    if limit is not None and limit.isdecimal() and used is not None and used.isdecimal():
        available = min(available, max(int(limit) - int(used), 0))
    needed = ring_bytes + num_processes * _PROCESS_BYTES
    told = f"{available / 2**30:.1f} GiB free, about {needed / 2**30:.1f} GiB needed"
    if available < needed:
        return problem(
            "memory", told, "end other programs, lower the cameras' width and height, or add memory"
        )
    return ok("memory", told)


def _kilobytes(text: str, key: str) -> int | None:
    for line in text.splitlines():
        name, _, value = line.partition(":")
        fields = value.split()
        if name == key and fields and fields[0].isdecimal():
            return 1024 * int(fields[0])
    return None


def check_disk(machine: Machine, folder: Path, bytes_per_s: float) -> Finding:
    """Recordings fit onto the disk for a while.

    Args:
        machine: see there.
        folder: where recordings would go.
        bytes_per_s: of all cameras, as they are recorded.
    """
    free = machine.free_bytes(folder)
    if free is None:
        return warning("disk", f"{folder}: free space cannot be read", f"df -h {folder}")
    told = f"{free / 2**30:.1f} GiB free for recordings in {folder}"
    mend = f"df -h {folder}   # make room, or record to another disk"
    if free < _LEAST_FREE:
        return problem("disk", f"{told}, expected at least {_LEAST_FREE >> 30} GiB", mend)
    if bytes_per_s <= 0:
        return ok("disk", told)
    minutes = free / bytes_per_s / 60.0
    told += f": {minutes:,.0f} minutes at {bytes_per_s / 1e6:,.0f} MB/s"
    return warning("disk", told, mend) if minutes < _WARN_MINUTES else ok("disk", told)


def check_clock(machine: Machine, *, uses_ptp: bool = False) -> Finding:
    """The clock follows another one: several machines, and cameras with PTP, are compared by it."""
    daemons = {machine.read(path) for path in machine.names("/proc/[0-9]*/comm")}
    if uses_ptp and not daemons & {"ptp4l", "ptpd", "ptpd2"}:
        return warning(
            "clock",
            "cameras are told to use PTP, but no PTP daemon runs here",
            "sudo apt-get install linuxptp && sudo ptp4l -i INTERFACE -m   # INTERFACE: the cameras'",
        )
    synchronised = machine.clock_is_synchronised()
    if synchronised is None:
        return ok("clock", "the kernel does not tell whether it is synchronised")
    if not synchronised:
        return warning(
            "clock",
            "not synchronised: harmless with one machine; cameras of other machines will be paired wrongly",
            "sudo apt-get install chrony",
        )
    return ok("clock", "synchronised")


def check_processor(machine: Machine) -> Finding:
    """The processor has what the compiled code uses: instructions for half floats, and a second core for the light beside the cameras."""
    cores = machine.num_processors()
    told = f"{cores} core{'s' if cores > 1 else ''}"
    for line in (machine.read("/proc/cpuinfo") or "").splitlines():
        name, _, value = line.partition(":")
        # Processors of other kinds than x86 name their features elsewhere, and those with 64 bits all have half floats.
        if name.strip() == "flags" and "f16c" not in value.split():
            return problem(
                "processor",
                f"{told}, without F16C (conversion of half floats)",
                "use an x86 processor made since 2013, or let the virtual machine see the host's (QEMU: -cpu host)",
            )
    if cores < 2:
        return warning("processor", f"{told}: frames will be late", "use a machine with two cores or more")
    return ok("processor", told)


def check_governor(machine: Machine) -> Finding:
    """The processor does not save power while frames come."""
    paths = machine.names(_GOVERNORS)
    governors = sorted({machine.read(path) or "unknown" for path in paths})
    if not governors:
        return ok("frequency", "not governed here")
    if "powersave" in governors:
        return warning(
            "frequency",
            f"governor {', '.join(governors)}: frames will jitter",
            f"echo performance | sudo tee {_GOVERNORS}",
        )
    return ok("frequency", f"governor {', '.join(governors)}")

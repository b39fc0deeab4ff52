"""The clock of a simulated camera: it starts when the camera does, runs a little too fast or slow, and can jump."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class DeviceClock:
    """Device time as a line over host time.

    Attributes:
        host_ns: where the line begins. device_ns: what the device's clock showed then.
        ppm: how much faster than the host's it runs, parts per million.
    """

    host_ns: int
    device_ns: int = 0
    ppm: float = 0.0

    def at(self, host_ns: int) -> int:
        """Device time, nanoseconds, at a time of the host's clock."""
        elapsed_ns = host_ns - self.host_ns
        return self.device_ns + elapsed_ns + round(elapsed_ns * self.ppm * 1e-6)

    def run_at(self, ppm: float, host_ns: int) -> None:
        """Run at another speed from now on, without a jump."""
        self.host_ns, self.device_ns, self.ppm = host_ns, self.at(host_ns), ppm

    def jump(self, by_ns: int) -> None:
        """Show another time from now on."""
        self.device_ns += by_ns

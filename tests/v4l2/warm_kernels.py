"""Compiles what the tests of the whole way need, for the processor that QEMU simulates: it would take minutes itself.

`guest.sh` runs this with a cache of its own, which the virtual machine gets to see.
"""

from __future__ import annotations

import numpy as np

from nearfield_server.capture.darkroom import Darkroom
from nearfield_server.capture.device import Exposure, SensorFrame
from nearfield_server.capture.v4l2.formats import find_format
from nearfield_server.scene.device_schema import V4l2SourceTable

WIDTH, HEIGHT = 64, 48


def frame_of(name: str, exposure: Exposure) -> SensorFrame:
    """A picture of noise."""
    known = find_format(name)
    row_bytes = known.row_bytes(WIDTH)
    return SensorFrame(
        data=np.random.default_rng(1).integers(0, 16, row_bytes * HEIGHT, np.uint8),
        pixel_format=known.pixel_format,
        width=WIDTH,
        height=HEIGHT,
        row_bytes=row_bytes,
        frame_id=0,
        device_ns=None,
        arrival_ns=0,
        exposure=exposure,
    )


def main() -> None:
    """Develop a single picture and a bracket of each kind of format."""
    exposures = [Exposure(time_s=time_s) for time_s in (0.02, 0.008, 0.0032)]
    out = np.zeros((HEIGHT, WIDTH, 4), np.float16)
    for name in ("GREY", "SRGGB12"):
        table = V4l2SourceTable(kind="v4l2", path="/dev/null", pixel_format=name)
        darkroom = Darkroom("warm", table, WIDTH, HEIGHT)
        darkroom.develop(frame_of(name, exposures[0]), exposures[0], out)
        for index, exposure in enumerate(exposures):
            darkroom.store(index, frame_of(name, exposure))
        darkroom.ratios(exposures)
        darkroom.merge(exposures, out)


if __name__ == "__main__":
    main()

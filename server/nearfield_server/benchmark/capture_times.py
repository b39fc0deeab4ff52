"""What a picture costs on its way from the sensor into the ring, and from the ring onto the disk, next to the errors that are left.

All figures of a run come from interleaved rounds of the same process. CPU time is that of all threads. The yardstick is a copy of the
developed picture: nothing that touches every pixel once can be faster.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from nearfield_server.benchmark.ratios import ratio_spread, spread
from nearfield_server.capture.ingest import ingest_frame
from nearfield_server.capture.sensor_model import SensorModel
from nearfield_server.errors import ConfigError
from nearfield_server.imaging.development import Developer
from nearfield_server.recording.files.exr_store import encode_exr
from nearfield_server.recording.files.frame_info import FrameInfo
from nearfield_server.recording.files.manifest import CameraEntry
from nearfield_server.recording.files.packed_picture import pack_picture, unpack_picture
from nearfield_server.recording.heap import keep_freed_memory
from nearfield_server.records import FRAME_TILE
from nearfield_server.scene.device_schema import SensorTable
from nearfield_server.scene.room_config import load_room
from nearfield_server.virtual_camera.formats import pack, sampled, sent_format
from nearfield_server.virtual_camera.scenery import Scenery
from nearfield_server.virtual_camera.sensor import Readout, expose

FORMAT: Final = "BayerRG12p"
BRACKET: Final = (1.0, 0.1, 0.01, 0.001, 0.0001)
"""Exposures relative to the longest one."""
_BLACK_LEVEL: Final = 200.0
_FULL_WELL_ELECTRONS: Final = 32_000.0
_READ_NOISE_ELECTRONS: Final = 5.0
_HEADROOM: Final = 0.9
"""The brightest pixel in the shortest exposure, as a share of the full well."""
_LENS_BLUR: Final = 0.7
"""Pixels: path-traced pictures are sharper than any lens, and nobody knows what then lies between the samples of a mosaic."""
_RANGE: Final = 1e5
_DARK: Final = 1e-3
"""Mean radiance below which a pixel lies outside the image circle."""
_WEDGE: Final = 10.0**-4.2
"""A grey wedge before the lens spreads the room, of three orders of magnitude, over more than five."""

_Actions = dict[str, Callable[[], object]]


def measure_capture(bundle: Path, rounds: int) -> dict[str, Any]:
    """Run all rounds on the first camera of a bundle.

    Args:
        bundle: with path-traced pictures of a camera.
        rounds: interleaved rounds.

    Returns:
        The section `capture` of bench.json. `cpu_ms` and `to_copy` (ratio to a copy of the picture): medians per step, quartiles under
        `spread`. `bytes_per_pixel` on the wire and on the disk. Errors against the truth, relative, of pixels that are no lower bounds:
        `single` of one exposure over two orders of magnitude, `merge` of five over five: `median`, `p99`. `raw_bits_changed`: bits of
        a picture that a raw recording did not bring back.

    Raises:
        ConfigError: the bundle's first camera is not simulated, or sees nothing.
        AssetError: the bundle is broken.
    """
    keep_freed_memory()
    bench = _Bench(*_scene(bundle))
    samples: dict[str, list[float]] = {name: [] for name in bench.actions}
    for number in range(rounds + 1):
        for name, action in bench.actions.items():
            started = time.process_time()
            action()
            if number:  # the first round compiles
                samples[name].append(1e3 * (time.process_time() - started))
    ratios = {name: ratio_spread(cost, samples["copy"]) for name, cost in samples.items() if name != "copy"}
    return {
        "picture": f"{bench.width} x {bench.height}, {FORMAT}",
        "rounds": rounds,
        "cpu_ms": {name: spread(cost).median for name, cost in samples.items()},
        "to_copy": {name: ratio.median for name, ratio in ratios.items()}
        | {"spread": {name: ratio.as_dict() for name, ratio in ratios.items()}},
        "bytes_per_pixel": bench.bytes_per_pixel(),
        "errors": bench.errors(),
        "raw_bits_changed": bench.raw_bits_changed(),
    }


def _scene(bundle: Path) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(H, W, 3) radiance, and (H, W) where the lens shows the room."""
    room = load_room(bundle)
    scenery = Scenery(room, room.cameras[0].camera_id)
    traced = scenery.radiance(scenery.nominal_weights)
    picture = gaussian_filter(traced, (_LENS_BLUR, _LENS_BLUR, 0))
    wedge = np.geomspace(1.0, _WEDGE, len(picture))[:, None, None]
    return np.ascontiguousarray(picture * wedge, np.float32), traced.mean(axis=2) > _DARK


class _Bench:
    """A scene, its exposures as the camera sends them, and everything that is done with them."""

    def __init__(self, truth: NDArray[np.float32], inside: NDArray[np.bool_]) -> None:
        self.truth, self.inside = truth, inside
        self.height, self.width = truth.shape[:2]
        brightest = float(truth.max())
        longest = _HEADROOM / (brightest * min(BRACKET))
        self.amounts = [longest * share for share in BRACKET]
        self.payloads = [self._exposed(amount, frame) for frame, amount in enumerate(self.amounts)]
        self.developer = Developer(SensorTable(black_level=_BLACK_LEVEL), FORMAT, self.width, self.height)
        shape = (self.height, self.width, 4)
        self.single, self.merged, self.ingested, self.copied = (np.zeros(shape, np.float16) for _ in range(4))
        tiles = math.ceil(self.height / FRAME_TILE), math.ceil(self.width / FRAME_TILE)
        self.changed = np.zeros(tiles, np.bool_)
        self.before = np.zeros(shape, np.float16)
        self.packed, self.unpacked = b"", self.copied
        self.camera = CameraEntry(camera_id="0", height=self.height, width=self.width, calibration_id="")
        self.info = FrameInfo(
            take=1, sequence=1, content_revision=1, timestamp_ns=1, counters={}, metadata={}
        )
        self.actions: _Actions = {
            "copy": lambda: np.copyto(self.copied, self.merged),
            "develop": self._develop,
            "bracket_of_3": lambda: self._merge(self.payloads[2:], self.amounts[2:]),
            "bracket_of_5": lambda: self._merge(self.payloads, self.amounts),
            "ingest": self._ingest,
            "record_raw": self._pack,
            "read_raw": self._unpack,
            "record_exr": lambda: encode_exr(self.camera, self.info, self.ingested),
        }

    def _exposed(self, amount: float, frame: int) -> NDArray[np.uint8]:
        sent = sent_format(FORMAT)
        sensor = SensorModel(
            full_well_radiance=1.0,
            full_well_electrons=_FULL_WELL_ELECTRONS,
            read_noise_electrons=_READ_NOISE_ELECTRONS,
            seed=frame + 1,
        )
        codes = np.empty((self.height, self.width), np.uint16)
        readout = Readout(exposure_s=amount, black_level=_BLACK_LEVEL, bits=sent.bits)
        expose(sampled(self.truth, sent), sensor, readout, frame, codes)
        payload = np.empty(sent.num_bytes(self.width, self.height), np.uint8)
        pack(codes, sent, payload)
        return payload

    def _develop(self) -> None:
        self.developer.develop(self.payloads[-1], 0, self.amounts[-1], self.single)

    def _merge(self, payloads: list[NDArray[np.uint8]], amounts: list[float]) -> None:
        for position, payload in enumerate(payloads):
            self.developer.keep(position, payload, 0)
        self.developer.merge(amounts, self.merged)

    def _ingest(self) -> None:
        ingest_frame(self.merged, self.ingested, self.inside, previous=self.before, changed=self.changed)

    def _pack(self) -> None:
        self.packed = b"".join(pack_picture(self.ingested))

    def _unpack(self) -> None:
        self.unpacked = unpack_picture(self.packed, self.height, self.width, "benchmark")

    def bytes_per_pixel(self) -> dict[str, float]:
        """Of one picture: as the camera sends it, in memory, and in either recording."""
        pixels = self.height * self.width
        return {
            "wire": self.payloads[0].size / pixels,
            "ring": self.merged.nbytes / pixels,
            "raw": len(self.packed) / pixels,
            "exr": len(encode_exr(self.camera, self.info, self.ingested)) / pixels,
        }

    def errors(self) -> dict[str, dict[str, float]]:
        """Relative, over channels of pixels that are measured, down to a part of what the brightest one has."""
        self._develop()
        self._merge(self.payloads, self.amounts)
        return {"single": self._error(self.single, 1e2), "merge": self._error(self.merged, _RANGE)}

    def _error(self, found: NDArray[np.float16], brightness_range: float) -> dict[str, float]:
        floor = float(self.truth.max()) / brightness_range
        usable = self.inside & (found[..., 3] == 1.0) & (self.truth.min(axis=2) >= floor)
        error = np.abs(found[usable, :3].astype(np.float64) / self.truth[usable] - 1.0)
        if error.size == 0:
            raise ConfigError(
                f"no pixel is measured that has at least 1 / {brightness_range:g} of the brightest one's radiance; expected a lit room"
            )
        return {
            "median": float(np.median(error)),
            "p99": float(np.quantile(error, 0.99)),
            "share": float(usable.sum() / self.inside.sum()),
        }

    def raw_bits_changed(self) -> int:
        """Compare what went into a raw recording with what comes back, bit for bit."""
        difference = self.unpacked.view(np.uint16) ^ self.ingested.view(np.uint16)
        return int(np.unpackbits(difference.view(np.uint8)).sum())

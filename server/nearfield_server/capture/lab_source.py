"""A simulated camera in a room whose lamps can be dimmed: light is linear, so a picture is a weighted sum of basis pictures."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.capture.sensor_model import SensorModel, simulate_sensor
from nearfield_server.capture.source import RawFrame, wait_for_period
from nearfield_server.errors import CaptureError
from nearfield_server.scene.exr import read_exr


@dataclass(frozen=True, slots=True, kw_only=True)
class Timeline:
    """Lighting weights over time, the same for every camera because it runs on the absolute monotonic clock.

    Attributes:
        weights: (frames, lights) float64 >= 0.
        frame_rate: frames per second; the timeline repeats.
    """

    weights: NDArray[np.float64]
    frame_rate: float

    def at(self, now_ns: int) -> NDArray[np.float64]:
        """Return the weights (lights,) at a time of CLOCK_MONOTONIC."""
        row: NDArray[np.float64] = self.weights[int(now_ns * 1e-9 * self.frame_rate) % len(self.weights)]
        return row


@dataclass(frozen=True, slots=True, kw_only=True)
class LabCamera:
    """One simulated camera.

    Attributes:
        camera_id: name for messages.
        basis_files: one EXR per switchable light: the room lit by that light alone, at weight 1 of a white basis light.
        light_scales: (lights, 3) float64, nominal radiance of each light divided by the basis radiance of its picture.
        height: pixels expected. width: pixels expected.
        timeline: multiplies the weights that users set; None = they alone count.
        sensor: adds noise and saturation; every frame is then different. None = the exact picture.
    """

    camera_id: str
    basis_files: tuple[Path, ...]
    light_scales: NDArray[np.float64]
    height: int
    width: int
    timeline: Timeline | None = None
    sensor: SensorModel | None = None


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _mix(basis: NDArray[np.float32], factors: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Weighted sum over the first axis: (K, P, 3) with factors (K, 3) to (P, 3), in float32."""
    for pixel in range(basis.shape[1]):
        red = green = blue = np.float32(0.0)
        for light in range(basis.shape[0]):
            red += factors[light, 0] * basis[light, pixel, 0]
            green += factors[light, 1] * basis[light, pixel, 1]
            blue += factors[light, 2] * basis[light, pixel, 2]
        out[pixel, 0] = red
        out[pixel, 1] = green
        out[pixel, 2] = blue


@dataclass(slots=True)
class LabSource:
    """`Source` of a simulated camera: the sum is formed again only when a weight has changed, or for every frame if the sensor is noisy."""

    camera: LabCamera
    _basis: NDArray[np.float32] | None = None
    _weights: tuple[float, ...] = ()
    _mixed_weights: NDArray[np.float64] | None = None
    _picture: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0, 3), np.float32))
    _revision: int = 0

    def open(self) -> None:
        """Read the basis pictures.

        Raises:
            AssetError: a file is missing or broken.
            CaptureError: a picture has another size than the camera, or the number of pictures is not that of the lights.
        """
        camera = self.camera
        if len(camera.basis_files) != len(camera.light_scales):
            raise CaptureError(
                f"camera {camera.camera_id}: {len(camera.basis_files)} basis pictures for {len(camera.light_scales)} lights; "
                "expected one per light"
            )
        pictures = []
        for path in camera.basis_files:
            picture = read_exr(path)
            if picture.shape[:2] != (camera.height, camera.width) or picture.shape[2] < 3:
                raise CaptureError(
                    f"{path}: picture of shape {picture.shape}, "
                    f"expected {(camera.height, camera.width, 3)} as camera {camera.camera_id} says"
                )
            pictures.append(picture[..., :3].reshape(-1, 3))
        self._basis = np.ascontiguousarray(np.stack(pictures), dtype=np.float32)
        self._picture = np.zeros((camera.height, camera.width, 3), np.float32)
        if len(self._weights) != len(camera.light_scales):
            self._weights = (1.0,) * len(camera.light_scales)
        self._mixed_weights = None

    def close(self) -> None:
        """Free the pictures."""
        self._basis = None

    def set_light_weights(self, weights: tuple[float, ...]) -> None:
        """Dim or switch the lights; weights beyond the number of lights are an error of the room file and refused."""
        if len(weights) != len(self.camera.light_scales):
            raise CaptureError(
                f"camera {self.camera.camera_id}: {len(weights)} light weights for {len(self.camera.light_scales)} lights"
            )
        self._weights = weights

    def wait_for_frame(self, stop: threading.Event, period_s: float) -> None:
        """Wait for the next period."""
        wait_for_period(stop, period_s)

    def next_frame(self, now_ns: int) -> RawFrame | None:
        """Return the picture under the present weights; the same revision means the very same picture."""
        if self._basis is None:
            raise CaptureError(f"camera {self.camera.camera_id}: next_frame before open")
        weights = np.asarray(self._weights, np.float64)
        if self.camera.timeline is not None:
            weights = weights * self.camera.timeline.at(now_ns)
        changed = self._mixed_weights is None or not np.array_equal(weights, self._mixed_weights)
        if changed:
            factors = (weights[:, None] * self.camera.light_scales).astype(np.float32)
            _mix(self._basis, factors, self._picture.reshape(-1, 3))
            self._mixed_weights = weights
        pixels, counters = self._picture, {}
        if self.camera.sensor is not None:
            pixels, counters["saturated"] = simulate_sensor(self._picture, self.camera.sensor, self._revision)
        if changed or self.camera.sensor is not None:
            self._revision += 1
        return RawFrame(
            pixels=pixels, timestamp_ns=now_ns, content_revision=self._revision, counters=counters
        )

    def describe(self) -> dict[str, str | int | float | bool]:
        """Describe the source for the status page."""
        return {
            "kind": "lab",
            "lights": len(self.camera.basis_files),
            "timeline": self.camera.timeline is not None,
            "noise": self.camera.sensor is not None,
        }

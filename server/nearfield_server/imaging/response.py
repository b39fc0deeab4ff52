"""The response of a sensor: from codes to signal, the share of the linear range of one exposure, without the black level.

Signal is proportional to light: radiance = signal / (seconds times gain) times `radiance_per_code`. It is negative where noise leaves a
code below the black level, and stays so until the very end: averages of dark pixels would otherwise come out too bright.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import ConfigError
from nearfield_server.imaging.pixel_formats import PixelFormat
from nearfield_server.scene.device_schema import KneeResponseTable, SensorTable, TableResponseTable


def srgb_to_linear(encoded: NDArray[np.float64]) -> NDArray[np.float64]:
    """The curve of IEC 61966-2-1, for values in [0, 1]."""
    linear: NDArray[np.float64] = np.where(
        encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0.0) + 0.055) / 1.055) ** 2.4
    )
    return linear


def signal_of_codes(
    codes: NDArray[np.float64], table: SensorTable, layout: PixelFormat
) -> NDArray[np.float64]:
    """Signal of codes, in float64: the definition; `make_lookup` tabulates it.

    - linear: (code - black level) / (largest code - black level).
    - knee: the same with the codes that a sensor of the first slope all over would have sent; the signal exceeds 1 above the knees.
    - table: linear between the points, at its lower end also beyond, minus the value at the black level.
    - linear, but a format for displays (YUV, JPEG): the curve of sRGB is undone first. Cameras apply other curves too; a table overrides.

    Args:
        codes: any shape.
        table: response and black level.
        layout: number of bits, and whether codes were made for a display.

    Returns:
        Signal like `codes`; codes above the range count as the largest.
    """
    top = float(layout.top_code)
    codes = np.minimum(np.asarray(codes, np.float64), top)
    black = table.black_level
    response = table.response
    if isinstance(response, TableResponseTable):
        return _interpolated(codes, response) - float(_interpolated(np.array(black), response))
    if isinstance(response, KneeResponseTable):
        worth = codes.copy()
        slope = 1.0
        for share, knee_slope in response.knees:
            worth += (knee_slope - slope) * np.maximum(codes - share * top, 0.0)
            slope = knee_slope
        return (worth - black) / (top - black)
    if layout.is_video:
        ends = srgb_to_linear(np.array([black / top, 1.0]))
        signal: NDArray[np.float64] = (srgb_to_linear(codes / top) - ends[0]) / (ends[1] - ends[0])
        return signal
    return (codes - black) / (top - black)


def _interpolated(codes: NDArray[np.float64], response: TableResponseTable) -> NDArray[np.float64]:
    points, signals = np.asarray(response.codes), np.asarray(response.signal)
    slope = (signals[1] - signals[0]) / (points[1] - points[0])
    inside = np.interp(codes, points, signals)
    below: NDArray[np.float64] = np.where(codes < points[0], signals[0] + (codes - points[0]) * slope, inside)
    return below


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """A tabulated response.

    Attributes:
        lookup: (65536,) float32, signal of each code.
        saturated_from: the least code that is no measurement, only a lower bound.
        step: signal of one code at the dark end; what noise is compared with where nothing better is known.
    """

    lookup: NDArray[np.float32]
    saturated_from: int
    step: float


def make_response(table: SensorTable, layout: PixelFormat) -> Response:
    """Tabulate a response.

    Raises:
        ConfigError: black level at or above the saturation threshold, or a table for codes of another range.
    """
    saturated_from = int(np.ceil(table.saturation * layout.top_code))
    if table.black_level >= saturated_from:
        raise ConfigError(
            f"black_level = {table.black_level:g}, expected a code below {saturated_from} "
            f"(saturation = {table.saturation:g} of {layout.bits} bits)"
        )
    response = table.response
    if isinstance(response, TableResponseTable) and not (
        response.codes[0] < saturated_from and response.codes[-1] <= layout.top_code + 1
    ):
        raise ConfigError(
            f"response.codes: expected codes of {layout.name} (0 to {layout.top_code}), "
            f"found {response.codes[0]:g} to {response.codes[-1]:g}"
        )
    signal = signal_of_codes(np.arange(65536.0), table, layout)
    dark = int(np.ceil(table.black_level))
    step = float(np.max(np.diff(signal[dark : dark + 3])))
    return Response(lookup=signal.astype(np.float32), saturated_from=saturated_from, step=step)

"""The fast path: payloads of a camera to a picture of half floats that ingest can take over, a row at a time.

A row is unpacked, linearised, merged with the same row of the other exposures, and split into half rows that stay in the nearest cache
until the two rows below it are there; then its colours are interpolated, multiplied by the colour matrix, and written as words of four
halves. So a picture is read once and written once.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nearfield_server.errors import CaptureError, ConfigError
from nearfield_server.imaging.bracket_plan import radiance_histogram
from nearfield_server.imaging.demosaic import PAD, interpolate_colours, interpolate_green, split_row
from nearfield_server.imaging.exposure_check import exposure_ratio
from nearfield_server.imaging.hdr_merge import add_row, check_amounts, end_row
from nearfield_server.imaging.pixel_formats import pixel_format
from nearfield_server.imaging.response import make_response
from nearfield_server.imaging.unpacking import plain_rows, unpack_row
from nearfield_server.radiometry.half import HALF_MAX, float_to_half
from nearfield_server.records import LOWER_BOUND_BITS, VALID_BITS
from nearfield_server.scene.device_schema import SensorTable

BOUND_ALPHA: Final = np.array(LOWER_BOUND_BITS, np.uint16).view(np.float16)[()]
"""The largest half below 1: alpha of a pixel whose radiance is only a lower bound."""
LINEAR_OFFSET: Final = 1.0 / 512.0
OFFSET_STEPS: Final = 8.0
_RING: Final = 8
_SMALLEST_SIDE: Final = 4
_CHECK_ROWS: Final = 8
_JIT: Final = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_JIT)  # type: ignore[untyped-decorator]
def _measured_row(
    payloads: NDArray[np.uint8],
    layout: tuple[int, int, int, int, bool],
    row: int,
    lookup: NDArray[np.float32],
    saturated_from: int,
    amounts: NDArray[np.float64],
    codes: NDArray[np.uint16],
    sums: NDArray[np.float32],
    out: NDArray[np.float32],
    is_bound: NDArray[np.uint8],
) -> int:
    """One row of samples, merged over all exposures; number of samples that are only lower bounds."""
    row_bytes, packing, bits, channels, variant = layout
    unpack_row(payloads[0], row, row_bytes, packing, bits, channels, variant, codes)
    if payloads.shape[0] == 1:
        count = np.int64(0)
        limit = np.uint16(saturated_from)
        for index in range(codes.shape[0]):
            out[index] = lookup[codes[index]]
        for index in range(codes.shape[0]):
            is_bound[index] = np.uint8(codes[index] >= limit)
            count += np.int64(codes[index] >= limit)
        return int(count)
    for exposure in range(payloads.shape[0]):
        if exposure:
            unpack_row(payloads[exposure], row, row_bytes, packing, bits, channels, variant, codes)
        add_row(codes, lookup, saturated_from, amounts[exposure], exposure == 0, sums)
    return int(end_row(sums, out, is_bound))


@njit(**_JIT)  # type: ignore[untyped-decorator]
def _pack_pixels(
    red: NDArray[np.float32],
    green: NDArray[np.float32],
    blue: NDArray[np.float32],
    matrix: NDArray[np.float32],
    out: NDArray[np.uint64],
) -> None:
    """Pixels (n,) as words of four halves: through the matrix (3, 4), not below 0; what exceeds the half range is a lower bound."""
    zero, largest = np.float32(0.0), np.float32(HALF_MAX)
    m00, m01, m02, m03 = matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[0, 3]
    m10, m11, m12, m13 = matrix[1, 0], matrix[1, 1], matrix[1, 2], matrix[1, 3]
    m20, m21, m22, m23 = matrix[2, 0], matrix[2, 1], matrix[2, 2], matrix[2, 3]
    valid, bound = np.uint64(VALID_BITS << 48), np.uint64(LOWER_BOUND_BITS << 48)
    for index in range(out.shape[0]):
        r = max(m00 * red[index] + m01 * green[index] + m02 * blue[index] + m03, zero)
        g = max(m10 * red[index] + m11 * green[index] + m12 * blue[index] + m13, zero)
        b = max(m20 * red[index] + m21 * green[index] + m22 * blue[index] + m23, zero)
        alpha = bound if max(max(r, g), b) > largest else valid
        out[index] = (
            np.uint64(float_to_half(min(r, largest)))
            | np.uint64(float_to_half(min(g, largest))) << np.uint64(16)
            | np.uint64(float_to_half(min(b, largest))) << np.uint64(32)
            | alpha
        )


@njit(**_JIT)  # type: ignore[untyped-decorator]
def _interleave(even: NDArray[np.uint64], odd: NDArray[np.uint64], out: NDArray[np.uint64]) -> None:
    for index in range(even.shape[0]):
        out[2 * index] = even[index]
        out[2 * index + 1] = odd[index]


@njit(**_JIT)  # type: ignore[untyped-decorator]
def _mirrored(row: int, height: int) -> int:
    row = abs(row)
    return row if row < height else 2 * height - 2 - row


@njit(**_JIT)  # type: ignore[untyped-decorator]
def _mark_row(
    above: NDArray[np.uint8],
    here: NDArray[np.uint8],
    below: NDArray[np.uint8],
    parity: int,
    words: NDArray[np.uint64],
) -> None:
    """Mark pixels (W,) of a mosaic's row as lower bounds if their own sample, or one that they take another colour from, is one.

    Green samples take colours from the four nearest samples, colour samples from all eight; beyond the edges the picture is mirrored.
    """
    width = words.shape[0]
    clear, bound = np.uint64((1 << 48) - 1), np.uint64(LOWER_BOUND_BITS << 48)
    for column in range(width):
        left, right = abs(column - 1), min(column + 1, 2 * width - 3 - column)
        found = here[column] | here[left] | here[right] | above[column] | below[column]
        if column & 1 == parity:
            found |= above[left] | above[right] | below[left] | below[right]
        if found:
            words[column] = words[column] & clear | bound


@njit(**_JIT)  # type: ignore[untyped-decorator]
def _count_bounds(words: NDArray[np.uint64]) -> int:
    count = np.int64(0)
    for index in range(words.shape[0]):
        count += np.int64(words[index] >> np.uint64(48) == np.uint64(LOWER_BOUND_BITS))
    return int(count)


@njit(**_JIT)  # type: ignore[untyped-decorator]
def _develop_mosaic(
    payloads: NDArray[np.uint8],
    layout: tuple[int, int, int, int, bool],
    lookup: NDArray[np.float32],
    saturated_from: int,
    amounts: NDArray[np.float64],
    first_parity: int,
    is_red_first: bool,
    offset: np.float32,
    matrix: NDArray[np.float32],
    out: NDArray[np.uint64],
) -> int:
    """A Bayer picture (H, W): `first_parity` is the column of the first red or blue sample of row 0, `is_red_first` its colour."""
    height, width = out.shape
    half = width // 2
    codes = np.empty(width, np.uint16)
    sums = np.empty((4, width), np.float32)
    samples = np.empty(width, np.float32)
    bounds = np.zeros((_RING, width), np.uint8)
    has_bounds = np.zeros(_RING, np.bool_)
    colour = np.empty((_RING, half + 2 * PAD), np.float32)
    green = np.empty((_RING, half + 2 * PAD), np.float32)
    at_colour = np.empty((_RING, half + 2 * PAD), np.float32)
    other = np.empty(half, np.float32)
    both = np.empty((2, half), np.float32)
    words = np.empty((2, half), np.uint64)
    count = np.int64(0)
    last = _RING - 1
    for step in range(height + 3):
        if step < height:
            place = step & last
            found = _measured_row(
                payloads, layout, step, lookup, saturated_from, amounts, codes, sums, samples, bounds[place]
            )
            has_bounds[place] = found != 0
            split_row(samples, first_parity ^ (step & 1), offset, colour[place], green[place])
        row = step - 2
        if 0 <= row < height:
            above, below = _mirrored(row - 1, height) & last, _mirrored(row + 1, height) & last
            interpolate_green(
                colour[row & last],
                green[row & last],
                colour[_mirrored(row - 2, height) & last],
                colour[_mirrored(row + 2, height) & last],
                green[above],
                green[below],
                first_parity ^ (row & 1),
                offset,
                at_colour[row & last],
            )
        row = step - 3
        if row < 0:
            continue
        parity = first_parity ^ (row & 1)
        here, above, below = row & last, _mirrored(row - 1, height) & last, _mirrored(row + 1, height) & last
        interpolate_colours(
            colour[here],
            green[here],
            at_colour[here],
            colour[above],
            colour[below],
            at_colour[above],
            at_colour[below],
            parity,
            other,
            both,
        )
        own, own_green, plain = colour[here, PAD:-PAD], at_colour[here, PAD:-PAD], green[here, PAD:-PAD]
        if is_red_first == (row & 1 == 0):
            _pack_pixels(own, own_green, other, matrix, words[parity])
            _pack_pixels(both[0], plain, both[1], matrix, words[1 - parity])
        else:
            _pack_pixels(other, own_green, own, matrix, words[parity])
            _pack_pixels(both[1], plain, both[0], matrix, words[1 - parity])
        _interleave(words[0], words[1], out[row])
        if has_bounds[here] or has_bounds[above] or has_bounds[below]:
            _mark_row(bounds[above], bounds[here], bounds[below], parity, out[row])
        count += _count_bounds(out[row])
    return int(count)


@njit(**_JIT)  # type: ignore[untyped-decorator]
def _develop_plain(
    payloads: NDArray[np.uint8],
    layout: tuple[int, int, int, int, bool],
    lookup: NDArray[np.float32],
    saturated_from: int,
    amounts: NDArray[np.float64],
    matrix: NDArray[np.float32],
    out: NDArray[np.uint64],
) -> int:
    """A picture without a mosaic, of one or three channels."""
    height, width = out.shape
    channels = layout[3]
    codes = np.empty(width * channels, np.uint16)
    sums = np.empty((4, width * channels), np.float32)
    samples = np.empty(width * channels, np.float32)
    bounds = np.empty(width * channels, np.uint8)
    planes = np.empty((channels, width), np.float32)
    green, blue = (1, 2) if channels == 3 else (0, 0)
    clear, bound = np.uint64((1 << 48) - 1), np.uint64(LOWER_BOUND_BITS << 48)
    count = np.int64(0)
    for row in range(height):
        found = _measured_row(
            payloads, layout, row, lookup, saturated_from, amounts, codes, sums, samples, bounds
        )
        if channels == 3:
            for column in range(width):
                planes[0, column] = samples[3 * column]
                planes[1, column] = samples[3 * column + 1]
                planes[2, column] = samples[3 * column + 2]
        else:
            planes[0] = samples
        target = out[row]
        _pack_pixels(planes[0], planes[green], planes[blue], matrix, target)
        if found:
            for column in range(width):
                first = channels * column
                if bounds[first] | bounds[first + green] | bounds[first + blue]:
                    target[column] = target[column] & clear | bound
        count += _count_bounds(target)
    return int(count)


@njit(**_JIT)  # type: ignore[untyped-decorator]
def _take_rows(
    payload: NDArray[np.uint8],
    layout: tuple[int, int, int, int, bool],
    rows: NDArray[np.int64],
    out: NDArray[np.uint16],
) -> None:
    row_bytes, packing, bits, channels, variant = layout
    for index in range(rows.shape[0]):
        unpack_row(payload, rows[index], row_bytes, packing, bits, channels, variant, out[index])


class Developer:
    """Develops the pictures of one camera: codes to radiance, alpha 1 or, where only a lower bound is known, just below 1.

    A single exposure: `develop`. A bracket: `keep` every exposure, in any order, and `merge` them. Nothing is allocated between pictures.
    """

    def __init__(self, table: SensorTable, pixel_format_name: str, width: int, height: int) -> None:
        """Tabulate the response.

        Args:
            table: black level, saturation, response, colour matrix and scale of the room file.
            pixel_format_name: as `SensorFrame.pixel_format` says.
            width: pixels.
            height: pixels.

        Raises:
            CaptureError: the pixel format is not known.
            ConfigError: the response does not fit the format, or the picture is no mosaic of 2 x 2 samples.
        """
        self.format = pixel_format(pixel_format_name)
        self.width, self.height = width, height
        if self.format.bayer and (width % 2 or height % 2 or min(width, height) < _SMALLEST_SIDE):
            raise ConfigError(
                f"{self.format.name}: expected an even width and height of at least {_SMALLEST_SIDE} pixels, "
                f"found {width} x {height}; change the region"
            )
        self.response = make_response(table, self.format)
        self.saturated = 0
        """Pixels of the last picture whose radiance is only a lower bound."""
        is_colour = self.format.channels == 3 or self.format.bayer is not None
        matrix = np.eye(3) if table.color_matrix is None or not is_colour else np.array(table.color_matrix)
        self._matrix = table.radiance_per_code * matrix
        self._offset = np.float32(
            max(OFFSET_STEPS * self.response.step, LINEAR_OFFSET * (table.response.kind == "linear"))
        )
        self._kept: dict[int, NDArray[np.uint8]] = {}
        self._arguments: tuple[int, int, int, int, bool] = (0, 0, 0, 0, False)
        self._store = np.empty((0, 0), np.uint8)

    def develop(
        self, data: NDArray[np.uint8], row_bytes: int, amount: float, out: NDArray[np.float16]
    ) -> NDArray[np.float16]:
        """Develop a single exposure.

        Args:
            data: (bytes,) uint8, the payload.
            row_bytes: from one row to the next; 0 without padding.
            amount: seconds times gain of the exposure.
            out: (H, W, 4) float16, contiguous, written completely: radiance in W/(sr m^2) or relative, and alpha.

        Returns:
            `out`. Values are finite and not negative; those above the half range are 65504.

        Raises:
            CaptureError: the payload is too short or damaged, or `out` has another shape.
        """
        rows, arguments = plain_rows(data, self.format, self.width, self.height, row_bytes)
        return self._run(rows[None], arguments, check_amounts([amount]), out)

    def keep(self, position: int, data: NDArray[np.uint8], row_bytes: int) -> None:
        """Keep an exposure of a bracket; its payload is copied, as it came.

        Args:
            position: in the bracket, from 0; replaces what was there.
            data: (bytes,) uint8, the payload.
            row_bytes: from one row to the next; 0 without padding. The same for all.

        Raises:
            CaptureError: the payload is too short or damaged.
        """
        rows, arguments = plain_rows(data, self.format, self.width, self.height, row_bytes)
        needed = rows.size if row_bytes == 0 and self.format.pixel_bits == 0 else self._bytes(row_bytes)
        if self._store.shape[1] != needed or position >= len(self._store) or arguments != self._arguments:
            grown = np.empty((max(position + 1, len(self._store)), needed), np.uint8)
            if self._store.shape[1] == needed and arguments == self._arguments:
                grown[: len(self._store)] = self._store
            self._store, self._arguments = grown, arguments
        self._store[position] = rows[:needed]

    def _bytes(self, row_bytes: int) -> int:
        return self.format.payload_bytes(self.width, self.height, row_bytes)

    def ratios(self, num_exposures: int) -> list[tuple[int, int, float]]:
        """Measure how the exposures kept are related, from the pixels that are valid in both of a pair.

        Args:
            num_exposures: the pictures at positions 0 to this are compared, each with each.

        Returns:
            (i, j, r): the picture at position i had r times the exposure of that at j; NaN where too few pixels are valid in both.

        Raises:
            CaptureError: fewer exposures were kept.
        """
        self._check_kept(num_exposures)
        bands = max(1, self.height // (8 * _CHECK_ROWS))
        rows = np.arange(bands)[:, None] * (self.height // bands) + np.arange(min(_CHECK_ROWS, self.height))
        rows = np.minimum(rows.reshape(-1), self.height - 1)
        codes = np.empty((num_exposures, len(rows), self.width * self.format.channels), np.uint16)
        for position in range(num_exposures):
            _take_rows(self._store[position], self._arguments, rows, codes[position])
        response = self.response
        return [
            (
                i,
                j,
                exposure_ratio(codes[i], codes[j], response.lookup, response.saturated_from, response.step),
            )
            for i in range(num_exposures)
            for j in range(i + 1, num_exposures)
        ]

    def merge(self, amounts: Sequence[float], out: NDArray[np.float16]) -> NDArray[np.float16]:
        """Merge the exposures kept, see `hdr_merge`, and develop the result.

        Args:
            amounts: seconds times gain of the pictures at positions 0, 1, ...
            out: see `develop`.

        Returns:
            `out`, see `develop`.

        Raises:
            CaptureError: fewer exposures were kept, an amount is none, or `out` has another shape.
        """
        checked = check_amounts(amounts)
        self._check_kept(len(checked))
        return self._run(self._store[: len(checked)], self._arguments, checked, out)

    def _check_kept(self, num_exposures: int) -> None:
        if num_exposures > len(self._store):
            raise CaptureError(f"bracket: {num_exposures} exposures expected, {len(self._store)} were kept")

    def _run(
        self,
        payloads: NDArray[np.uint8],
        arguments: tuple[int, int, int, int, bool],
        amounts: NDArray[np.float64],
        out: NDArray[np.float16],
    ) -> NDArray[np.float16]:
        if out.shape != (self.height, self.width, 4) or out.dtype != np.float16 or not out.flags.c_contiguous:
            raise CaptureError(
                f"developed picture: expected contiguous float16 of shape {(self.height, self.width, 4)}, "
                f"found {out.dtype} of shape {out.shape}"
            )
        # Samples are relative to the longest exposure while they are merged: near 1, whatever the exposures are.
        longest = float(amounts.max())
        scaled = self._matrix / longest
        # Samples of a mosaic come raised by the offset.
        foot = -float(self._offset) if self.format.bayer else 0.0
        matrix = np.column_stack((scaled, foot * scaled.sum(1))).astype(np.float32)
        response = self.response
        common = payloads, arguments, response.lookup, response.saturated_from, amounts / longest
        words = out.view(np.uint64)[..., 0]
        if self.format.bayer is None:
            self.saturated = int(_develop_plain(*common, matrix, words))
        else:
            green = self.format.bayer.index("G")
            is_red_first = self.format.bayer[1 - green] == "R"
            self.saturated = int(
                _develop_mosaic(*common, 1 - green, is_red_first, self._offset, matrix, words)
            )
        return out


@cache
def compile_kernels() -> None:
    """Compile all that developing needs, or load it from the cache: no camera is to wait seconds at its first picture."""
    table, out = SensorTable(), np.zeros((_SMALLEST_SIDE, _SMALLEST_SIDE, 4), np.float16)
    for name in ("BayerRG8", "Mono8"):
        developer = Developer(table, name, _SMALLEST_SIDE, _SMALLEST_SIDE)
        for position in range(2):
            developer.keep(position, np.zeros(_SMALLEST_SIDE**2, np.uint8), 0)
        developer.ratios(2)
        developer.merge([1.0, 0.5], out)
    radiance_histogram(out)

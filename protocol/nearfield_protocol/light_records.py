"""Virtual area lights and SH in memory, and what they must satisfy before they can be written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol import quantise
from nearfield_protocol.errors import EncodeError
from nearfield_protocol.layout import MAX_OBJECTS, MAX_VALS

MAX_COORDINATE = 2.0**20
"""Bounds reach no further than this, metres: a thousand kilometres is a mistake in units."""

VAL_DTYPE = np.dtype(
    [
        ("position", "<f4", 3),
        ("normal", "<f4", 3),
        ("radiant_intensity", "<f4", 3),
        ("area", "<f4"),
        ("generation", "u1"),
    ]
)
"""A virtual area light in memory: metres in world axes, unit normal, W/sr per RGB channel, m^2, generation of the slot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LightPacket:
    """Everything that lights virtual objects at one moment.

    Attributes:
        sequence: counts packets, 0..2^32-1, wrapping.
        timestamp_ns: capture time of the oldest camera frame that took part, clock of the server.
        room_revision: of the room model that positions refer to.
        vals: (M,) VAL_DTYPE, slot order, M <= 64. A slot with zero radiant intensity holds no light; its position, normal and area
            have no meaning and are sent as (bounds_min, +z, 0).
        object_sh: (n, 9, 3) float32 sh_coeffs of the indirect radiance, world axes, W/m^2.
        object_revisions: (n,) uint32, revision of the pose for which the SH were taken.
        bounds_min: (3,) float32, lowest corner of a box that holds all VALs, metres. bounds_size: (3,) float32 > 0, its edges.
    """

    sequence: int
    timestamp_ns: int
    vals: NDArray[np.void]
    object_sh: NDArray[np.float32]
    object_revisions: NDArray[np.uint32]
    bounds_min: NDArray[np.float32]
    bounds_size: NDArray[np.float32]
    room_revision: int = 0


def empty_vals(count: int, bounds_min: NDArray[np.float32]) -> NDArray[np.void]:
    """`count` slots without light, as a decoder returns them."""
    vals = np.zeros(count, VAL_DTYPE)
    vals["position"] = bounds_min
    vals["normal"] = (0, 0, 1)
    return vals


def checked_unsigned(where: str, value: int, bits: int) -> int:
    """The value, if it fits into so many bits."""
    if not 0 <= value < 2**bits:
        raise EncodeError(where, expected=f"0 to 2^{bits} - 1", found=value)
    return value


def checked_bounds(packet: LightPacket) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lowest corner (3,) and size (3,) of the bounds."""
    low, size = np.asarray(packet.bounds_min, np.float32), np.asarray(packet.bounds_size, np.float32)
    if low.shape != (3,) or not (np.abs(low) <= MAX_COORDINATE).all():
        raise EncodeError(
            "bounds_min", expected=f"3 numbers of at most {MAX_COORDINATE:g} m", found=low.tolist()
        )
    if size.shape != (3,) or not ((size > 0) & (size <= MAX_COORDINATE)).all():
        raise EncodeError(
            "bounds_size", expected=f"3 numbers > 0, at most {MAX_COORDINATE:g} m", found=size.tolist()
        )
    return low, size


def checked_vals(
    vals: NDArray[np.void], bounds_min: NDArray[np.float32], bounds_size: NDArray[np.float32]
) -> NDArray[np.void]:
    """A copy in which slots without light are canonical, checked VAL by VAL."""
    if vals.ndim != 1 or len(vals) > MAX_VALS:
        raise EncodeError("vals", expected=f"(M,) with M <= {MAX_VALS}", found=vals.shape)
    vals = vals.astype(VAL_DTYPE)
    intensity = vals["radiant_intensity"]
    valid = ((intensity >= 0) & (intensity <= quantise.MAX_RADIOMETRIC)).all(axis=1)
    _check_each(valid, "radiant_intensity", intensity, "finite numbers from 0 to 2^126 W/sr")
    unused = ~(intensity > 0).any(axis=1)
    blank = empty_vals(int(unused.sum()), bounds_min)
    blank["generation"] = vals["generation"][unused]
    vals[unused] = blank
    position, normal, area = (
        vals["position"].astype(np.float64),
        vals["normal"].astype(np.float64),
        vals["area"],
    )
    # Half a step, and the rounding of a decoded position to float32: what the encoder itself wrote stays inside.
    slack = bounds_size / 131070.0 + np.abs(position) * 2.0**-22
    inside = (position >= bounds_min - slack) & (
        position <= bounds_min.astype(np.float64) + bounds_size + slack
    )
    bounds = f"inside {bounds_min.tolist()} + {bounds_size.tolist()}"
    _check_each((inside & np.isfinite(position)).all(axis=1), "position", vals["position"], bounds)
    length = np.linalg.norm(normal, axis=1)
    _check_each(np.abs(length - 1) <= 1e-3, "normal", vals["normal"], "a unit vector")
    _check_each((area >= 0) & (area <= quantise.AREA_MAX), "area", area, f"0 to {quantise.AREA_MAX:g} m^2")
    return vals


def _check_each(
    valid: NDArray[np.bool_] | np.bool_, field: str, values: NDArray[Any], expected: object
) -> None:
    if not np.all(valid):
        i = int(np.argmin(valid))
        raise EncodeError(f"vals[{i}].{field}", expected=expected, found=np.asarray(values[i]).tolist())


def checked_objects(packet: LightPacket) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """SH (n, 9, 3) and pose revisions (n,)."""
    object_sh = np.asarray(packet.object_sh, np.float32)
    if object_sh.ndim != 3 or object_sh.shape[1:] != (9, 3) or len(object_sh) > MAX_OBJECTS:
        raise EncodeError("object_sh", expected=f"(n, 9, 3) with n <= {MAX_OBJECTS}", found=object_sh.shape)
    valid = (np.abs(object_sh) <= quantise.MAX_RADIOMETRIC).all(axis=(1, 2))
    if not valid.all():
        raise EncodeError(
            f"object_sh[{int(np.argmin(valid))}]",
            expected="magnitudes of at most 2^126",
            found="a larger or non-finite one",
        )
    revisions = np.asarray(packet.object_revisions)
    if revisions.shape != (len(object_sh),):
        raise EncodeError("object_revisions", expected=(len(object_sh),), found=revisions.shape)
    return object_sh, revisions.astype(np.uint32)

"""Which pictures of several cameras belong together. Pure: the caller reads the rings and the clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

_PRESENT_WITHIN: Final = 1.5
"""Periods that a camera may be behind the newest picture before the others go on without it: one, and half for jitter."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of one camera and the time in which it shows the room, CLOCK_MONOTONIC ns.

    Attributes:
        sequence: number in its ring.
        from_ns: when it was taken.
        until_ns: when the camera last said that it still holds; `from_ns` if it never did.
    """

    sequence: int
    from_ns: int
    until_ns: int

    def distance_ns(self, time_ns: int) -> int:
        """How far a time is from that in which the picture holds."""
        return max(self.from_ns - time_ns, time_ns - self.until_ns, 0)


@dataclass(frozen=True, slots=True)
class PictureSet:
    """One picture per camera.

    Attributes:
        chosen: per camera; None where there is none.
        present: per camera, whether its picture is meant to show the same moment as the others.
        is_holding: a camera has a newer picture that waits for the others.
        spread_ns: between the moments that the present cameras show, as near to each other as their pictures allow.
    """

    chosen: tuple[Picture | None, ...]
    present: tuple[bool, ...]
    is_holding: bool
    spread_ns: int


def choose_pictures(
    pictures: Sequence[Sequence[Picture]], used: Sequence[int], period_ns: int, *, hold: bool = True
) -> PictureSet:
    """Choose the picture of each camera that is nearest to the newest moment which all present cameras have seen.

    A camera more than one and a half periods behind the newest picture is not present: the others go on without it, and its newest
    picture stays in use. So a picture waits at most one period for those of other cameras. Pictures never go back in time.

    Args:
        pictures: per camera, the whole pictures in its ring by ascending sequence.
        used: per camera, the sequence used last; older pictures are not chosen.
        period_ns: between two pictures of a camera.
        hold: false = the newest picture of every camera, whatever its time.
    """
    newest = [held[-1].until_ns for held in pictures if held]
    if not newest:
        empty = (None,) * len(pictures)
        return PictureSet(empty, (False,) * len(pictures), False, 0)
    oldest_present_ns = max(newest) - int(_PRESENT_WITHIN * period_ns)
    present = tuple(bool(held) and held[-1].until_ns >= oldest_present_ns for held in pictures)
    common_ns = min(time_ns for time_ns in newest if time_ns >= oldest_present_ns)
    chosen: list[Picture | None] = []
    for held, is_present, least in zip(pictures, present, used, strict=True):
        if not held:
            chosen.append(None)
        elif not (is_present and hold):
            chosen.append(held[-1])
        else:
            usable = [picture for picture in held if picture.sequence >= least] or [held[-1]]
            # Of two at equal distance the newer one.
            chosen.append(min(reversed(usable), key=lambda picture: picture.distance_ns(common_ns)))
    moments = [
        min(max(common_ns, picture.from_ns), picture.until_ns)
        for picture, is_present in zip(chosen, present, strict=True)
        if picture is not None and is_present
    ]
    is_holding = any(
        picture is not None and picture.sequence != held[-1].sequence
        for picture, held in zip(chosen, pictures, strict=True)
    )
    return PictureSet(tuple(chosen), present, is_holding, max(moments) - min(moments))

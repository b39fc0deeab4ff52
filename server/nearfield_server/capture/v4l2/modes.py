"""What a video node is and offers: identity, pixel formats, sizes, frame rates. Nothing is streamed or changed."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from nearfield_server.capture.v4l2 import kernel_api as api
from nearfield_server.capture.v4l2.formats import V4l2Format, code_of, find_code
from nearfield_server.capture.v4l2.video_node import VideoNode

_MOST_ENTRIES = 1024  # of a list; a driver that never says that it is at the end is not followed for ever


@dataclass(frozen=True, slots=True)
class Identity:
    """What a node says about itself.

    Attributes:
        driver: name of the kernel's driver ("uvcvideo").
        card: name of the camera.
        bus: where it is plugged in ("usb-0000:00:14.0-1").
        capabilities: of this node.
    """

    driver: str
    card: str
    bus: str
    capabilities: api.Capability

    @property
    def buffer_type(self) -> api.BufferType | None:
        """The queue that pictures come from; None if the node captures no pictures."""
        if not self.capabilities & api.Capability.STREAMING:
            return None
        if self.capabilities & api.Capability.VIDEO_CAPTURE:
            return api.BufferType.CAPTURE
        if self.capabilities & api.Capability.VIDEO_CAPTURE_MPLANE:
            return api.BufferType.CAPTURE_MPLANE
        return None


@dataclass(frozen=True, slots=True)
class SizeRange:
    """Sizes of a format: one size, or from a least to a greatest in steps.

    Attributes:
        least: (width, height), pixels. greatest: likewise; equal to `least` for one size.
        step: pixels along x and y; (0, 0) for one size.
    """

    least: tuple[int, int]
    greatest: tuple[int, int]
    step: tuple[int, int] = (0, 0)

    def holds(self, width: int, height: int) -> bool:
        """Whether a size is one of these."""
        for wanted, low, high, step in zip(
            (width, height), self.least, self.greatest, self.step, strict=True
        ):
            if not low <= wanted <= high or (step and (wanted - low) % step):
                return False
        return True

    def __str__(self) -> str:
        low = f"{self.least[0]}x{self.least[1]}"
        if self.least == self.greatest:
            return low
        steps = "" if max(self.step) <= 1 else f" in steps of {self.step[0]}x{self.step[1]}"
        return f"{low} to {self.greatest[0]}x{self.greatest[1]}{steps}"


@dataclass(frozen=True, slots=True)
class FormatChoice:
    """A pixel format that a node offers.

    Attributes:
        fourcc: number of the format. code: its four characters.
        description: as the driver words it.
        known: the format as this project reads it; None if it does not.
        sizes: empty where the driver does not tell.
    """

    fourcc: int
    code: str
    description: str
    known: V4l2Format | None
    sizes: tuple[SizeRange, ...]

    @property
    def name(self) -> str:
        """What a room file calls it."""
        return self.known.usual_name if self.known else self.code.strip()

    @property
    def sizes_in_words(self) -> str:
        """The sizes of the format."""
        return ", ".join(map(str, self.sizes)) or "sizes unknown"


def describe_choices(choices: Iterable[FormatChoice]) -> str:
    """List formats in words; those with the same sizes together: "GREY, SRGGB12 (640x480, 320x240); MJPEG (1280x720)"."""
    names: dict[str, list[str]] = {}
    for choice in choices:
        names.setdefault(choice.sizes_in_words, []).append(choice.name)
    return "; ".join(f"{', '.join(alike)} ({sizes})" for sizes, alike in names.items())


def read_identity(node: VideoNode) -> Identity:
    """Ask a node what it is.

    Raises:
        OSError: it is no video node, or gone.
    """
    answer = api.QueryCap()
    node.call(api.Request.QUERYCAP, answer)
    has_own = answer.capabilities & api.Capability.DEVICE_CAPS
    return Identity(
        driver=api.text(answer.driver),
        card=api.text(answer.card),
        bus=api.text(answer.bus_info),
        capabilities=api.Capability(answer.device_caps if has_own else answer.capabilities),
    )


_Entry = TypeVar("_Entry", api.FmtDesc, api.FrameSize, api.FrameInterval)


def _enumerate(node: VideoNode, request: api.Request, make: Callable[[int], _Entry]) -> Iterator[_Entry]:
    """Entries of a list until the driver says EINVAL; nothing where it has no such list."""
    for index in range(_MOST_ENTRIES):
        entry = make(index)
        try:
            node.call(request, entry)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY, errno.ENODATA):
                return
            raise
        yield entry


def list_formats(node: VideoNode, buffer_type: api.BufferType) -> tuple[FormatChoice, ...]:
    """List pixel formats with their sizes.

    Raises:
        OSError: the device is gone.
    """
    entries = list(
        _enumerate(node, api.Request.ENUM_FMT, lambda index: api.FmtDesc(index=index, type=buffer_type))
    )
    return tuple(
        FormatChoice(
            fourcc=entry.pixelformat,
            code=code_of(entry.pixelformat),
            description=api.text(entry.description),
            known=find_code(code_of(entry.pixelformat)),
            sizes=list_sizes(node, entry.pixelformat),
        )
        for entry in entries
    )


def list_sizes(node: VideoNode, fourcc: int) -> tuple[SizeRange, ...]:
    """List the sizes of one pixel format; empty where the driver does not tell."""
    sizes = []
    entries = _enumerate(
        node, api.Request.ENUM_FRAMESIZES, lambda index: api.FrameSize(index=index, pixel_format=fourcc)
    )
    for entry in entries:
        if entry.type == api.SizeType.DISCRETE:
            size = (entry.discrete.width, entry.discrete.height)
            sizes.append(SizeRange(size, size))
            continue
        limits = entry.stepwise
        sizes.append(
            SizeRange(
                (limits.min_width, limits.min_height),
                (limits.max_width, limits.max_height),
                (limits.step_width, limits.step_height),
            )
        )
        break  # ranges have one entry
    return tuple(sizes)


def list_rates(node: VideoNode, fourcc: int, width: int, height: int) -> tuple[float, ...]:
    """List frame rates of a format and size, frames per second, descending; for a range its two ends."""
    rates: set[float] = set()
    entries = _enumerate(
        node,
        api.Request.ENUM_FRAMEINTERVALS,
        lambda index: api.FrameInterval(index=index, pixel_format=fourcc, width=width, height=height),
    )
    for entry in entries:
        is_discrete = entry.type == api.SizeType.DISCRETE
        intervals = [entry.discrete] if is_discrete else [entry.stepwise.min, entry.stepwise.max]
        rates.update(part.denominator / part.numerator for part in intervals if part.numerator)
        if not is_discrete:
            break
    return tuple(sorted(rates, reverse=True))

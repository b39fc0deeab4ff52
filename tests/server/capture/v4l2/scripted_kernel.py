"""A camera and its driver as the V4L2 specification describes them, behind the `VideoNode` interface.

`ScriptedCamera` is the hardware with its driver: it outlives opened files, like controls and formats do in a kernel. `ScriptedNode` is one
opened file. Sources of the behaviour, all of the Linux Media User Space API: VIDIOC_S_FMT takes the nearest size and says so (section
"Negotiation"); EBUSY while another file owns the queue (VIDIOC_REQBUFS); a queue is owned until REQBUFS(0), or until the file is closed and
nothing of it is mapped any more; sequence numbers count pictures that had no buffer too; VIDIOC_DQBUF gives EAGAIN, EIO, EINVAL when not
streaming, ENODEV when unplugged; controls clamp and round (VIDIOC_S_EXT_CTRLS) and refuse missing menu items with EINVAL.

Exposure: a control written while picture n is being exposed shows from picture n + `delay` on.
"""

from __future__ import annotations

import ctypes
import errno
import os
import time
import weakref
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.v4l2 import kernel_api as api
from nearfield_server.capture.v4l2.formats import fourcc_of
from nearfield_server.capture.v4l2.video_node import Readiness

CAPTURE = api.Capability.VIDEO_CAPTURE | api.Capability.STREAMING
CAPTURE_MPLANE = api.Capability.VIDEO_CAPTURE_MPLANE | api.Capability.STREAMING


def fail(number: int) -> OSError:
    return OSError(number, os.strerror(number))


@dataclass
class ScriptedControl:
    number: int
    name: str
    minimum: int = 0
    maximum: int = 255
    step: int = 1
    default: int = 0
    kind: int = api.ControlType.INTEGER
    flags: int = 0
    menu: dict[int, str | int] = field(default_factory=dict)
    value: int | None = None
    refusal: int | None = None

    def __post_init__(self) -> None:
        self.value = self.default if self.value is None else self.value
        if self.menu:
            self.kind = (
                api.ControlType.MENU
                if isinstance(next(iter(self.menu.values())), str)
                else api.ControlType.INTEGER_MENU
            )
            self.minimum, self.maximum = min(self.menu), max(self.menu)

    def write(self, value: int) -> None:
        if self.refusal is not None:
            raise fail(self.refusal)
        if self.flags & api.ControlFlag.READ_ONLY:
            raise fail(errno.EACCES)
        if self.menu and value not in self.menu:
            raise fail(errno.EINVAL)
        clamped = min(max(value, self.minimum), self.maximum)
        if self.kind == api.ControlType.INTEGER:
            clamped = self.minimum + round((clamped - self.minimum) / self.step) * self.step
        self.value = clamped


@dataclass
class Shot:
    """One picture that the camera takes.

    Attributes:
        error: damaged in transfer. short: that many bytes are missing. timestamp_ns: of the driver.
    """

    error: bool = False
    short: int = 0
    timestamp_ns: int = 0


class ScriptedCamera:
    def __init__(
        self,
        *,
        formats: dict[str, list[tuple[int, int]]] | None = None,
        controls: list[ScriptedControl] | None = None,
        capabilities: int = CAPTURE,
        rates: tuple[int, ...] = (30, 15),
        padding: int = 0,
        stamps: int = api.BufferFlag.TIMESTAMP_MONOTONIC,
        delay: int = 2,
    ) -> None:
        self.formats = formats or {"GREY": [(64, 48), (32, 24)], "RG12": [(64, 48)]}
        self.stepwise: dict[str, tuple[int, ...]] = {}
        self.controls = {control.number: control for control in controls or []}
        self.capabilities, self.rates, self.padding, self.stamps = capabilities, rates, padding, stamps
        self.delay = delay
        self.field = int(api.Field.NONE)
        self.num_planes = 1
        self.colour: dict[str, int] = {}  # fields of the format that tell how colours are coded
        self.driver = b"scripted"
        self.fewest_buffers = 2
        self.most_buffers = 32
        self.period = (1, rates[0]) if rates else (0, 0)
        self.format = fourcc_of(next(iter(self.formats)))
        self.size = next(iter(self.formats.values()))[0]
        self.owner: ScriptedNode | None = None
        self.plugged = True
        self.broken = False
        self.open_error: int | None = None
        self.stream_error: int | None = None
        self.map_error_at: int | None = None  # no memory for the mapping of this buffer
        self.forgets_exposure_at_start = False
        self.stopped = False  # by the driver: nothing comes any more, and poll says so
        self.after_write: Callable[[], object] = lambda: None  # limits that depend on other controls
        self.script: deque[Callable[[], object]] = deque()  # what happens while somebody waits
        self.written: list[tuple[str, int]] = []  # every control that was set, in order
        self.open_nodes = 0
        self.sequence = 0
        self._storage: list[bytearray] = []
        self._views: list[weakref.ref[NDArray[np.uint8]]] = []
        self._queued: deque[int] = deque()
        self._done: deque[tuple[int, int, Shot, int]] = deque()
        self.streaming = False
        self._pipeline: deque[int] = deque()

    # -- for tests ----------------------------------------------------------------------------------------------------------

    def open(self, path: str) -> ScriptedNode:
        if self.open_error is not None:
            raise fail(self.open_error)
        if not self.plugged:
            raise fail(errno.ENOENT)
        return ScriptedNode(self)

    def control(self, number: int) -> ScriptedControl:
        return self.controls[number]

    def shoot(self, *shots: Shot) -> None:
        """Take pictures; each shows the exposure value that was set `delay` pictures ago in all its bytes (modulo 256)."""
        for shot in shots or (Shot(),):
            self._pipeline.append(self._exposure_value())
            shown = self._pipeline.popleft() if len(self._pipeline) > self.delay else self._pipeline[0]
            sequence, self.sequence = self.sequence, (self.sequence + 1) % 2**32
            if not self._queued:
                continue  # nowhere to put it: lost
            index = self._queued.popleft()
            length = max(0, self._bytes_per_line() * self.size[1] - shot.short)
            self._storage[index][:length] = bytes([shown % 256]) * length
            self._done.append((index, sequence, shot, length))

    def lose(self, count: int) -> None:
        """Take pictures that the driver drops."""
        self.sequence = (self.sequence + count) % 2**32

    def fill(self, data: bytes) -> None:
        """Take a picture with these bytes."""
        index = self._queued.popleft()
        self._storage[index][: len(data)] = data
        self._done.append((index, self.sequence, Shot(), len(data)))
        self.sequence += 1

    def unplug(self) -> None:
        self.plugged = False
        self.streaming = False

    def replug(self) -> None:
        """Plug it in again: the camera has lost its controls, and old files stay dead."""
        self.plugged = True
        self.broken = False
        self.owner = None
        self.sequence = 0
        self._storage, self._queued, self._done = [], deque(), deque()
        for control in self.controls.values():
            control.value = control.default

    @property
    def num_buffers(self) -> int:
        return len(self._storage)

    @property
    def num_queued(self) -> int:
        return len(self._queued)

    # -- the driver ---------------------------------------------------------------------------------------------------------

    def _exposure_value(self) -> int:
        for number in (api.ControlId.EXPOSURE_ABSOLUTE, api.ControlId.EXPOSURE):
            if number in self.controls:
                return int(self.controls[number].value or 0)
        return 0

    def _bytes_per_line(self) -> int:
        wide = {"GREY": 1, "RG12": 2, "YUYV": 2, "RGB3": 3, "Y16 ": 2}
        code = self.format.to_bytes(4, "little").decode()
        return 0 if code == "MJPG" else self.size[0] * wide.get(code, 1) + self.padding

    def still_mapped(self) -> bool:
        return any(view() is not None for view in self._views)

    def allocate(self, node: ScriptedNode, count: int) -> int:
        if self.owner is not None and self.owner is not node:
            raise fail(errno.EBUSY)
        if self.streaming:
            raise fail(errno.EBUSY)
        self._queued.clear()
        self._done.clear()
        if count == 0:
            self._storage, self._views, self.owner = [], [], None
            return 0
        count = min(max(count, self.fewest_buffers), self.most_buffers)
        length = max(4096, self._bytes_per_line() * self.size[1])
        self._storage = [bytearray(length) for _ in range(count)]
        self.owner = node
        return count

    def map(self, index: int) -> NDArray[np.uint8]:
        if index == self.map_error_at:
            raise fail(errno.ENOMEM)
        view = np.frombuffer(self._storage[index], np.uint8)
        self._views.append(weakref.ref(view))
        return view

    def start(self) -> None:
        if self.stream_error is not None:
            raise fail(self.stream_error)
        self.streaming = True
        self.sequence = 0
        self._pipeline.clear()
        if self.forgets_exposure_at_start:
            for number in (api.ControlId.EXPOSURE_ABSOLUTE, api.ControlId.GAIN):
                if number in self.controls:
                    self.controls[number].value = self.controls[number].default

    def stop(self) -> None:
        self.streaming = False
        self._queued.clear()
        self._done.clear()

    def enqueue(self, index: int) -> None:
        if (
            index >= len(self._storage)
            or index in self._queued
            or any(index == item[0] for item in self._done)
        ):
            raise fail(errno.EINVAL)
        self._queued.append(index)

    def dequeue(self) -> tuple[int, int, Shot, int]:
        if not self.streaming:
            raise fail(errno.EINVAL)
        if self.broken:
            raise fail(errno.EIO)
        if not self._done:
            raise fail(errno.EAGAIN)
        return self._done.popleft()

    def ready(self) -> Readiness:
        if not self.plugged or self.broken or self.stopped or not self.streaming:
            return Readiness.FAILED
        return Readiness.FRAME if self._done else Readiness.NOTHING


class ScriptedNode:
    """One opened file of a scripted camera."""

    def __init__(self, camera: ScriptedCamera) -> None:
        self._camera = camera
        self._is_open = True
        camera.open_nodes += 1

    def close(self) -> None:
        if self._is_open:
            self._is_open = False
            camera = self._camera
            camera.open_nodes -= 1
            if camera.owner is self and not camera.still_mapped():
                camera.stop()
                camera.owner = None

    def map(self, length: int, offset: int) -> NDArray[np.uint8]:
        return self._camera.map(offset // 4096)[:length]

    def wait(self, timeout_s: float) -> Readiness:
        camera = self._camera
        found = camera.ready()
        while found is Readiness.NOTHING and camera.script:
            camera.script.popleft()()
            found = camera.ready()
        if found is Readiness.NOTHING:
            time.sleep(min(timeout_s, 0.005))
        return found

    def call(self, request: int, argument: Any) -> None:
        if not self._is_open:
            raise fail(errno.EBADF)
        if not self._camera.plugged:
            raise fail(errno.ENODEV)
        handler = getattr(self, f"_{api.Request(request).name.lower()}", None)
        if handler is None:
            raise fail(errno.ENOTTY)
        handler(self._camera, argument)

    def _check_type(self, camera: ScriptedCamera, buffer_type: int) -> bool:
        """Whether the node is multi-planar; EINVAL for a queue that it does not have."""
        is_planar = not camera.capabilities & api.Capability.VIDEO_CAPTURE
        if buffer_type != (api.BufferType.CAPTURE_MPLANE if is_planar else api.BufferType.CAPTURE):
            raise fail(errno.EINVAL)
        return is_planar

    def _querycap(self, camera: ScriptedCamera, answer: api.QueryCap) -> None:
        answer.driver, answer.card, answer.bus_info = camera.driver, b"Scripted camera", b"usb-0000:00:14.0-1"
        answer.device_caps = camera.capabilities
        answer.capabilities = camera.capabilities | api.Capability.DEVICE_CAPS

    def _enum_fmt(self, camera: ScriptedCamera, entry: api.FmtDesc) -> None:
        self._check_type(camera, entry.type)
        codes = list(camera.formats)
        if entry.index >= len(codes):
            raise fail(errno.EINVAL)
        entry.pixelformat = fourcc_of(codes[entry.index])
        entry.description = f"format {codes[entry.index]}".encode()

    def _enum_framesizes(self, camera: ScriptedCamera, entry: api.FrameSize) -> None:
        code = int(entry.pixel_format).to_bytes(4, "little").decode()
        if code in camera.stepwise and entry.index == 0:
            entry.type = api.SizeType.STEPWISE
            (
                entry.stepwise.min_width,
                entry.stepwise.max_width,
                entry.stepwise.step_width,
                entry.stepwise.min_height,
                entry.stepwise.max_height,
                entry.stepwise.step_height,
            ) = camera.stepwise[code]
            return
        sizes = camera.formats.get(code, [])
        if code in camera.stepwise or entry.index >= len(sizes):
            raise fail(errno.EINVAL)
        entry.type = api.SizeType.DISCRETE
        entry.discrete.width, entry.discrete.height = sizes[entry.index]

    def _enum_frameintervals(self, camera: ScriptedCamera, entry: api.FrameInterval) -> None:
        if entry.index >= len(camera.rates):
            raise fail(errno.EINVAL)
        entry.type = api.SizeType.DISCRETE
        entry.discrete.numerator, entry.discrete.denominator = 1, camera.rates[entry.index]

    def _s_fmt(self, camera: ScriptedCamera, request: api.Format) -> None:
        is_planar = self._check_type(camera, request.type)
        if camera.owner is not None:
            raise fail(errno.EBUSY)
        pix = request.pix_mp if is_planar else request.pix
        by_fourcc = {fourcc_of(code): sizes for code, sizes in camera.formats.items()}
        if pix.pixelformat not in by_fourcc:
            pix.pixelformat = next(iter(by_fourcc))
        sizes = by_fourcc[pix.pixelformat]
        nearest = min(sizes, key=lambda size: abs(size[0] - pix.width) + abs(size[1] - pix.height))
        camera.format, camera.size = pix.pixelformat, nearest
        pix.width, pix.height = nearest
        pix.field = camera.field
        for name, value in camera.colour.items():
            setattr(pix, name, value)
        row = camera._bytes_per_line()
        if is_planar:
            pix.num_planes = camera.num_planes
            pix.plane_fmt[0].bytesperline, pix.plane_fmt[0].sizeimage = row, row * nearest[1]
        else:
            pix.bytesperline, pix.sizeimage = row, row * nearest[1]

    def _g_parm(self, camera: ScriptedCamera, answer: api.StreamParm) -> None:
        if not camera.rates:
            raise fail(errno.ENOTTY)
        answer.capture.capability = api.CAPABILITY_TIME_PER_FRAME
        answer.capture.timeperframe = api.Fraction(*camera.period)

    def _s_parm(self, camera: ScriptedCamera, request: api.StreamParm) -> None:
        wanted = request.capture.timeperframe.denominator / request.capture.timeperframe.numerator
        camera.period = (1, min(camera.rates, key=lambda rate: abs(rate - wanted)))
        self._g_parm(camera, request)

    def _query_ext_ctrl(self, camera: ScriptedCamera, answer: api.QueryExtCtrl) -> None:
        if answer.id & api.ControlFlag.NEXT_CTRL:
            after = answer.id & ~api.ControlFlag.NEXT_CTRL
            following = sorted(number for number in camera.controls if number > after)
            if not following:
                raise fail(errno.EINVAL)
            number = following[0]
        else:
            number = answer.id
        if number not in camera.controls:
            raise fail(errno.EINVAL)
        control = camera.controls[number]
        answer.id, answer.type, answer.name = number, control.kind, control.name.encode()
        answer.minimum, answer.maximum, answer.step = control.minimum, control.maximum, control.step
        answer.default_value, answer.flags, answer.elems = control.default, control.flags, 1

    def _querymenu(self, camera: ScriptedCamera, answer: api.QueryMenu) -> None:
        control = camera.controls.get(answer.id)
        if control is None or answer.index not in control.menu:
            raise fail(errno.EINVAL)
        item = control.menu[answer.index]
        if isinstance(item, str):
            answer.name = item.encode()
        else:
            answer.value = item

    def _entry(self, camera: ScriptedCamera, request: api.ExtControls) -> tuple[ScriptedControl, str, Any]:
        entry = request.controls[0]
        if request.count != 1 or entry.id not in camera.controls:
            raise fail(errno.EINVAL)
        control = camera.controls[entry.id]
        return control, "value64" if control.kind == api.ControlType.INTEGER64 else "value", entry

    def _g_ext_ctrls(self, camera: ScriptedCamera, request: api.ExtControls) -> None:
        control, name, entry = self._entry(camera, request)
        if control.flags & api.ControlFlag.WRITE_ONLY:
            raise fail(errno.EACCES)
        setattr(entry, name, control.value)

    def _s_ext_ctrls(self, camera: ScriptedCamera, request: api.ExtControls) -> None:
        control, name, entry = self._entry(camera, request)
        control.write(getattr(entry, name))
        camera.after_write()
        camera.written.append((control.name, int(control.value or 0)))
        setattr(entry, name, control.value)

    def _reqbufs(self, camera: ScriptedCamera, request: api.RequestBuffers) -> None:
        self._check_type(camera, request.type)
        request.count = camera.allocate(self, request.count)

    def _own(self, camera: ScriptedCamera) -> None:
        if camera.owner is not self:
            raise fail(errno.EBUSY)

    def _querybuf(self, camera: ScriptedCamera, buffer: api.Buffer) -> None:
        is_planar = self._check_type(camera, buffer.type)
        if buffer.index >= camera.num_buffers:
            raise fail(errno.EINVAL)
        buffer.flags = camera.stamps
        if is_planar:
            buffer.planes[0].length, buffer.planes[0].mem_offset = 4096, buffer.index * 4096
        else:
            buffer.length, buffer.offset = 1 << 20, buffer.index * 4096

    def _qbuf(self, camera: ScriptedCamera, buffer: api.Buffer) -> None:
        self._own(camera)
        camera.enqueue(buffer.index)

    def _dqbuf(self, camera: ScriptedCamera, buffer: api.Buffer) -> None:
        self._own(camera)
        is_planar = self._check_type(camera, buffer.type)
        index, sequence, shot, length = camera.dequeue()
        buffer.index, buffer.sequence = index, sequence
        buffer.flags = camera.stamps | (api.BufferFlag.ERROR if shot.error else 0)
        buffer.timestamp_s, rest_ns = divmod(shot.timestamp_ns, 1_000_000_000)
        buffer.timestamp_us = rest_ns // 1000
        if is_planar:
            buffer.planes[0].bytesused, buffer.planes[0].data_offset = length, 0
        else:
            buffer.bytesused = length

    def _streamon(self, camera: ScriptedCamera, argument: ctypes.c_int32) -> None:
        self._own(camera)
        self._check_type(camera, argument.value)
        camera.start()

    def _streamoff(self, camera: ScriptedCamera, argument: ctypes.c_int32) -> None:
        self._own(camera)
        camera.stop()

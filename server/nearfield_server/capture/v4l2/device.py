"""A camera of the Linux video system as a `Device`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.capture.v4l2 import kernel_api as api
from nearfield_server.capture.v4l2.control_setup import (
    set_automatics_off,
    set_image_controls_to_default,
    set_named_controls,
)
from nearfield_server.capture.v4l2.controls import ControlSet
from nearfield_server.capture.v4l2.discovery import read_serial
from nearfield_server.capture.v4l2.exposure_control import LineTiming, read_line_timing, set_blanking
from nearfield_server.capture.v4l2.exposure_setting import ExposureSetting, find_exposure_setting
from nearfield_server.capture.v4l2.faults import explain
from nearfield_server.capture.v4l2.formats import find_format
from nearfield_server.capture.v4l2.frame_queue import FilledBuffer, FrameQueue, SequenceCounter
from nearfield_server.capture.v4l2.modes import Identity, read_identity
from nearfield_server.capture.v4l2.picture_setup import Picture, set_frame_rate, set_picture
from nearfield_server.capture.v4l2.video_node import KernelNode, Readiness, VideoNode
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import BracketTable, V4l2SourceTable

_FEWEST_BUFFERS = 4
# One picture is being exposed and one being sent when a control is written, and USB cameras take it over a picture later.
_SETTLE_FRAMES = 3
_RATE_TOLERANCE = 0.02
_JPEG_START = b"\xff\xd8"


@dataclass(slots=True)
class _Session:
    """Everything that lives from `open` to `close`."""

    node: VideoNode
    identity: Identity
    picture: Picture
    timing: LineTiming | None
    setting: ExposureSetting
    queue: FrameQueue
    exposure: Exposure


class V4l2Device:
    """A camera behind /dev/video* (USB Video Class, MIPI CSI, capture cards).

    Sequence numbers, time stamps and error flags are the kernel's. Frames are views of the driver's memory until they are released.

    Args:
        camera_id: name for messages.
        table: the `source` table of the room file.
        width: pixels. height: pixels; the device must offer exactly this size.
        frame_rate: frames per second asked of the device.
        open_node: opens a path; replaced in tests.
    """

    def __init__(
        self,
        camera_id: str,
        table: V4l2SourceTable,
        width: int,
        height: int,
        frame_rate: float,
        *,
        open_node: Callable[[str], VideoNode] = KernelNode,
    ) -> None:
        self._camera_id, self._table = camera_id, table
        self._width, self._height, self._frame_rate = width, height, frame_rate
        self._open_node = open_node
        self._session: _Session | None = None
        self._counter = SequenceCounter()
        self._held: dict[int, int] = {}  # frame id -> buffer
        self._frames_broken = 0
        self._warnings: list[str] = []
        self._facts: dict[str, str | int | float | bool] = {}

    @contextmanager
    def _in_words(self, action: str) -> Iterator[None]:
        """Turn errors of the kernel into words that name the camera."""
        try:
            yield
        except OSError as error:
            raise explain(error, self._camera_id, self._table.path, action) from error
        except CaptureError as error:
            if str(error).startswith(f"camera {self._camera_id}"):
                raise
            raise CaptureError(f"camera {self._camera_id} ({self._table.path}): {error}") from error

    # -- life ---------------------------------------------------------------------------------------------------------------

    def open(self) -> DeviceCapabilities:
        """Open the node, apply every setting, start the stream.

        Raises:
            CaptureError: no such device, no permission, in use, or it refuses a setting; says what it would take.
        """
        self.close()
        self._warnings = []
        with self._in_words("open the device"):
            wanted = find_format(self._table.pixel_format)
            node = self._open_node(self._table.path)
        try:
            with self._in_words("set up the camera"):
                identity = read_identity(node)
                buffer_type = _picture_queue(identity)
                controls = ControlSet(node)
                self._warnings += set_automatics_off(controls, self._table.controls)
                self._warnings += set_image_controls_to_default(controls, self._table.controls)
                self._warnings += set_named_controls(controls, self._table.controls)
                picture = set_picture(node, buffer_type, wanted, self._width, self._height)
                controls = ControlSet(node)  # limits depend on the format
                timing = read_line_timing(controls, picture.width)
                rate = set_frame_rate(node, buffer_type, self._frame_rate)
                if rate is None and timing is not None:
                    rate = set_blanking(controls, timing, picture.height, self._frame_rate)
                controls = ControlSet(node)  # and on the frame rate
                setting = find_exposure_setting(controls, self._table, timing)
                wish, warnings = setting.first(self._table, self._frame_rate)
                self._warnings += warnings
                made = setting.apply(wish)
                queue = FrameQueue(node, buffer_type, self._num_buffers())
            self._session = _Session(node, identity, picture, timing, setting, queue, made)
            with self._in_words("start the stream"):
                self._counter.restart()
                queue.start()
                # Some cameras forget the exposure when a stream starts.
                if setting.read(made) != made:
                    self._session.exposure = setting.apply(wish)
        except BaseException:
            if self._session is None:
                node.close()
            self.close()
            raise
        self._note_rate(rate)
        if picture.is_rec709:
            self._warnings.append(
                "the camera mixes colours by BT.709, but they are read by BT.601: colours are off by some percent; take a raw format"
            )
        self._facts = self._describe(self._session)
        return DeviceCapabilities(
            exposure_range_s=setting.time.range_s if setting.time else (made.time_s, made.time_s),
            gain_range=setting.gain.range if setting.gain else (made.gain, made.gain),
            settle_frames=_SETTLE_FRAMES,
            device_clock=queue.is_monotonic,
        )

    def close(self) -> None:
        """Stop the stream, free the driver's queue, close the node."""
        session, self._session = self._session, None
        self._held.clear()
        if session is not None:
            session.queue.stop()
            session.node.close()

    def _num_buffers(self) -> int:
        """Enough for a reader that holds a whole bracket while the driver fills others."""
        hdr = self._table.hdr
        bracket = (len(hdr.exposures_s) or hdr.num_exposures) if isinstance(hdr, BracketTable) else 1
        return max(_FEWEST_BUFFERS, bracket + 3)

    def _note_rate(self, rate: float | None) -> None:
        if rate is not None and abs(rate - self._frame_rate) > _RATE_TOLERANCE * self._frame_rate:
            self._warnings.append(
                f"asked for {self._frame_rate:g} frames/s, the camera gives {rate:.4g} at this size and format"
            )

    def _describe(self, session: _Session) -> dict[str, str | int | float | bool]:
        identity = session.identity
        return {
            "model": identity.card,
            "serial": read_serial(Path(self._table.path)),
            "driver": identity.driver,
            "bus": identity.bus,
            "device_pixel_format": session.picture.format.usual_name,
            "buffers": len(session.queue),
            **({"clock": "host"} if session.queue.is_monotonic else {}),
        }

    # -- exposure -----------------------------------------------------------------------------------------------------------

    def set_exposure(self, exposure: Exposure) -> Exposure:
        """Expose the next frames so; pictures that wait already are dropped, because they have the old exposure.

        Raises:
            CaptureError: the device refuses or is gone.
        """
        session = self._opened()
        with self._in_words("set the exposure"):
            while (waiting := session.queue.take()) is not None:
                self._counter.unwrap(waiting.sequence)
                session.queue.put(waiting.index)
            session.exposure = session.setting.apply(exposure)
        return session.exposure

    def read_exposure(self) -> Exposure:
        """Ask the driver how the camera exposes now.

        Raises:
            CaptureError: the device is gone.
        """
        session = self._opened()
        with self._in_words("read the exposure"):
            return session.setting.read(session.exposure)

    def trigger(self) -> None:
        """V4L2 has no trigger.

        Raises:
            CaptureError: always.
        """
        raise CaptureError(
            f"camera {self._camera_id}: V4L2 cameras cannot be triggered; use method free_running"
        )

    def use_trigger(self, software: bool) -> None:
        """Run freely, as V4L2 cameras always do.

        Raises:
            CaptureError: a trigger is asked for.
        """
        if software:
            self.trigger()

    def program_sequence(self, exposures: Sequence[Exposure]) -> tuple[Exposure, ...]:
        """V4L2 has no sequencer.

        Raises:
            CaptureError: always.
        """
        raise CaptureError(
            f"camera {self._camera_id}: V4L2 cameras have no sequencer; use method free_running"
        )

    # -- frames -------------------------------------------------------------------------------------------------------------

    def next_frame(self, timeout_s: float) -> SensorFrame | None:
        """The oldest whole frame that waits; None after `timeout_s` without one.

        Raises:
            CaptureError: the camera is unplugged or its stream has failed.
        """
        session = self._opened()
        deadline_s = time.monotonic() + timeout_s
        readiness = Readiness.NOTHING
        with self._in_words("take a picture"):
            while True:
                filled = session.queue.take()
                if filled is not None:
                    frame = self._accept(session, filled)
                    if frame is not None:
                        return frame
                    continue  # a broken one; the next may wait already
                if readiness is Readiness.FAILED:
                    raise CaptureError("the driver has stopped the stream")
                remaining_s = deadline_s - time.monotonic()
                if remaining_s <= 0:
                    return None
                readiness = session.node.wait(remaining_s)

    def _accept(self, session: _Session, filled: FilledBuffer) -> SensorFrame | None:
        """A frame of a filled buffer; a broken one goes back to the driver."""
        arrival_ns = time.monotonic_ns()
        picture = session.picture
        frame_id = self._counter.unwrap(filled.sequence)
        is_whole = not filled.is_broken and filled.data.size >= picture.least_bytes
        if is_whole and picture.format.is_compressed:
            is_whole = filled.data[:2].tobytes() == _JPEG_START
        if not is_whole:
            self._frames_broken += 1
            session.queue.put(filled.index)
            return None
        self._held[frame_id] = filled.index
        return SensorFrame(
            data=filled.data,
            pixel_format=picture.pixel_format,
            width=picture.width,
            height=picture.height,
            row_bytes=picture.row_bytes,
            frame_id=frame_id,
            device_ns=self._start_ns(session, filled),
            arrival_ns=arrival_ns,
            exposure=session.exposure,
        )

    def _start_ns(self, session: _Session, filled: FilledBuffer) -> int | None:
        """When the exposure began, CLOCK_MONOTONIC.

        Drivers that stamp the end of the picture are put back by the exposure, and by the time of reading where the line time is known;
        else that is neglected: less than a frame time.
        """
        if not filled.is_monotonic:
            return None
        if filled.is_start:
            return filled.timestamp_ns
        read_s = session.timing.line_s * session.picture.height if session.timing else 0.0
        return filled.timestamp_ns - round((session.exposure.time_s + read_s) * 1e9)

    def release(self, frame: SensorFrame) -> None:
        """Give a frame's memory back to the driver; frames of an earlier stream are ignored.

        Raises:
            CaptureError: the device is gone.
        """
        index = self._held.pop(frame.frame_id, None)
        if self._session is not None and index is not None:
            with self._in_words("give a buffer back"):
                self._session.queue.put(index)

    def statistics(self) -> dict[str, str | int | float | bool]:
        """Numbers for the status page; counters run on when the camera is opened again."""
        return {
            **self._facts,
            "path": self._table.path,
            "frames_lost": self._counter.lost,
            "frames_broken": self._frames_broken,
            "warnings": "\n".join(self._warnings),
        }

    def _opened(self) -> _Session:
        if self._session is None:
            raise CaptureError(f"camera {self._camera_id} ({self._table.path}): the device is not open")
        return self._session


def _picture_queue(identity: Identity) -> api.BufferType:
    """The queue of a node.

    Raises:
        CaptureError: it captures no pictures.
    """
    if identity.buffer_type is not None:
        return identity.buffer_type
    if identity.capabilities & api.Capability.META_CAPTURE:
        raise CaptureError(
            f"this node of '{identity.card}' carries metadata, not pictures; take the camera's other node "
            "(its name under /dev/v4l/by-id ends in -video-index0)"
        )
    raise CaptureError(f"'{identity.card}' (driver {identity.driver}) captures no pictures by streaming")

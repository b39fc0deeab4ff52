"""A GigE Vision or USB3 Vision camera as a `Device`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

from nearfield_server.capture.aravis.chunks import LabelReader, switch_labels_on
from nearfield_server.capture.aravis.connection import Connection, connect
from nearfield_server.capture.aravis.exposure_control import ExposureControl
from nearfield_server.capture.aravis.features import Features
from nearfield_server.capture.aravis.frame_counter import FrameCounter
from nearfield_server.capture.aravis.health import Health
from nearfield_server.capture.aravis.library import Aravis, AravisError, ControlLostHandler, load
from nearfield_server.capture.aravis.release import release_later
from nearfield_server.capture.aravis.sequencer import Sequencer
from nearfield_server.capture.aravis.settings import (
    PictureLayout,
    apply_settings,
    has_software_trigger,
    lift_frame_rate,
    read_layout,
    set_frame_rate,
    set_trigger,
)
from nearfield_server.capture.aravis.stream import (
    ReceivedPicture,
    Stream,
    check_packet_size,
    negotiate_packet_size,
)
from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import AravisSourceTable

_Result = TypeVar("_Result")
_CLOSE_S: Final = 0.7
_CONTROL_CHECK_S: Final = 0.2
_HEALTH_PERIOD_S: Final = 5.0
_HEARTBEAT_MS: Final = (
    2000  # libaravis shows that it lives once a second; a camera is free so soon after its program died
)
_REGISTER_HEARTBEAT: Final = 0x0938  # GigE Vision 2.0, 28: heartbeat timeout, ms


@dataclass(slots=True)
class _Opened:
    """What exists only while the device is open."""

    connection: Connection
    features: Features
    control_lost_handler: Any
    exposure: ExposureControl
    sequencer: Sequencer
    health: Health
    is_control_lost: bool = False
    layout: PictureLayout | None = None
    labels: LabelReader | None = None
    stream: Stream | None = None
    commanded: Exposure = field(default_factory=lambda: Exposure(time_s=1.0))
    next_health_s: float = 0.0


class AravisDevice:
    """A camera through libaravis; see `Device` for its methods.

    Pictures are received into memory of this object, and lent out as views. A broken picture (packets missing, late, of wrong size) is
    counted and dropped. What arrives must have the pixel format and size that were set; else someone has changed the camera.

    Args:
        camera_id: names the camera in messages.
        table: of the room file.
        width: pixels, as calibrated. height: pixels.
        frame_rate: pictures per second, when running freely.
    """

    def __init__(
        self, camera_id: str, table: AravisSourceTable, width: int, height: int, frame_rate: float
    ) -> None:
        self._table, self._width, self._height, self._frame_rate = table, width, height, frame_rate
        self._where = (
            f"camera {camera_id} at {table.address}"
            if table.address
            else f"camera {camera_id} (serial {table.serial})"
        )
        self._opened: _Opened | None = None
        self._counter = FrameCounter()
        self._known: dict[str, str | int | float | bool] = {}
        self._vital: dict[str, str | int | float | bool] = {}
        self._warnings: list[str] = []
        self._may_label = True

    def open(self) -> DeviceCapabilities:
        """Connect, apply every setting, start the stream; raises CaptureError in words."""
        self.close()
        aravis = load()
        connection = connect(aravis, self._table, self._where)
        try:
            opened = self._prepare(aravis, connection)
        except BaseException:
            release_later(aravis, [connection.device])
            raise
        self._opened = opened
        try:
            return self._configure(aravis, opened)
        except CaptureError as error:
            self.close()
            raise self._named(error) from error
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Stop and give everything back; on a dead camera the rest happens in the background."""
        opened, self._opened = self._opened, None
        if opened is None:
            return
        aravis, stream = load(), opened.stream
        if stream is not None:
            stream.take_back_all()

        def stop() -> None:
            if stream is not None and not opened.is_control_lost:
                with contextlib.suppress(AravisError):  # a dead camera need not be stopped
                    aravis.stop_acquisition(opened.connection.device, stream.handle)

        parser = opened.labels.parser if opened.labels is not None else None
        release_later(
            aravis,
            [None if stream is None else stream.handle, parser, opened.connection.device],
            before=stop,
            keep=[stream, opened],
            wait_s=0.0 if opened.is_control_lost else _CLOSE_S,
        )

    def set_exposure(self, exposure: Exposure) -> Exposure:
        """Expose the next pictures so; ends a sequence. Returns what the device made of it."""
        opened = self._require_open()
        if opened.sequencer.is_running:
            self._while_stopped(self._end_sequence)
        opened.commanded = self._asked(lambda: opened.exposure.set(exposure))
        return opened.commanded

    def read_exposure(self) -> Exposure:
        """Ask the device how it exposes now."""
        return self._asked(self._require_open().exposure.read)

    def trigger(self) -> None:
        """Ask for one picture."""
        features = self._require_open().features
        self._asked(lambda: features.execute("TriggerSoftware"))

    def use_trigger(self, software: bool) -> None:
        """Pictures on request (true), or as the room file says: free running or at a hardware signal (false)."""
        features = self._require_open().features
        trigger = (
            "software" if software else "free" if self._table.trigger == "software" else self._table.trigger
        )

        def switch() -> None:
            set_trigger(features, trigger)
            self._set_rate(trigger)

        self._while_stopped(switch)

    def program_sequence(self, exposures: Sequence[Exposure]) -> tuple[Exposure, ...]:
        """Let the device cycle through exposures by itself, so fast that whole cycles come at the frame rate, or as fast as it can.

        Returns them as the device rounded them.
        """
        opened = self._require_open()
        if not opened.sequencer.is_offered:
            raise CaptureError(f"{self._where} has no sequencer")
        rounded: list[Exposure] = []

        def program() -> None:
            rounded.extend(opened.sequencer.program(exposures))
            self._set_rate(self._table.trigger, len(exposures))

        self._while_stopped(program)
        return tuple(rounded)

    def next_frame(self, timeout_s: float) -> SensorFrame | None:
        """The oldest whole picture that waits; None after `timeout_s` without one; raises CaptureError if the camera is lost or changed."""
        opened = self._require_open()
        stream = opened.stream
        assert stream is not None
        until_s = time.monotonic() + timeout_s
        while True:
            if opened.is_control_lost:
                raise CaptureError(
                    f"{self._where} is lost: it no longer answers, or another program took it over"
                )
            left_s = max(until_s - time.monotonic(), 0.0)
            came, picture = stream.take(min(left_s, _CONTROL_CHECK_S))
            if picture is not None:
                frame = self._frame(opened, stream, picture)
                if frame is not None:
                    self._look_after(opened)
                    return frame
            elif came:
                self._counter.incomplete()
            elif left_s <= _CONTROL_CHECK_S:
                return None

    def release(self, frame: SensorFrame) -> None:
        """Give the memory of a picture back; one of a stream that has ended is ignored."""
        if self._opened is not None and self._opened.stream is not None:
            self._opened.stream.give_back(frame.data)

    def statistics(self) -> dict[str, str | int | float | bool]:
        """What is known without asking the camera."""
        opened = self._opened
        found: dict[str, str | int | float | bool] = {
            **self._known,
            **self._vital,
            "frames_received": self._counter.received,
            "frames_lost": self._counter.lost,
            "frames_broken": self._counter.broken,
        }
        if opened is not None and opened.stream is not None:
            found.update(opened.stream.packets())
        if self._warnings:
            found["warnings"] = "\n".join(self._warnings)
        return found

    def _prepare(self, aravis: Aravis, connection: Connection) -> _Opened:
        features = Features(aravis, connection.device, self._where, connection.names)

        def control_lost(_device: int | None, _data: int | None) -> None:
            opened.is_control_lost = True  # in a thread of libaravis: nothing but this

        exposure = ExposureControl(features, self._where)
        opened = _Opened(
            connection=connection,
            features=features,
            control_lost_handler=ControlLostHandler(control_lost),
            exposure=exposure,
            sequencer=Sequencer(features, exposure, self._where),
            health=Health(features),
        )
        aravis.connect(connection.device, "control-lost", opened.control_lost_handler)
        return opened

    def _configure(self, aravis: Aravis, opened: _Opened) -> DeviceCapabilities:
        features, table, connection = opened.features, self._table, opened.connection
        is_gige = connection.camera.kind == "gige"
        if is_gige and not features.set_if_possible("GevHeartbeatTimeout", _HEARTBEAT_MS):
            with contextlib.suppress(AravisError):
                aravis.c.arv_device_write_register(connection.device, _REGISTER_HEARTBEAT, _HEARTBEAT_MS)
        if opened.sequencer.is_offered:
            opened.sequencer.stop()
        self._warnings = apply_settings(
            features, opened.exposure, table, self._width, self._height, self._frame_rate
        )
        set_trigger(features, table.trigger)
        is_labelling = self._may_label and switch_labels_on(features)
        opened.layout = read_layout(features, table, self._width, self._height)
        if is_gige:
            negotiate_packet_size(aravis, connection.device, table.packet_size)
        opened.stream = Stream(
            aravis, connection.device, is_gige, opened.layout.payload_bytes, table.num_buffers
        )
        self._known = _describe(connection, opened)
        if is_gige:
            self._known["packet_size"] = check_packet_size(aravis, connection.device, table.packet_size)
            self._known["receive_buffer_bytes"] = opened.stream.receive_buffer_bytes
        if opened.stream.warning:
            self._warnings.append(opened.stream.warning)
        if is_labelling:
            opened.labels = LabelReader(aravis, connection.device)
        opened.commanded = opened.exposure.read()
        self._vital = opened.health.read()
        opened.next_health_s = time.monotonic() + _HEALTH_PERIOD_S
        self._counter.restarted()
        opened.stream.start()
        return DeviceCapabilities(
            exposure_range_s=opened.exposure.range_s,
            gain_range=opened.exposure.gain_range,
            software_trigger=has_software_trigger(features),
            sequencer=opened.sequencer.is_offered and is_labelling,
            labels_exposure=is_labelling,
            device_clock=connection.ticks_per_s > 0,
        )

    def _frame(self, opened: _Opened, stream: Stream, picture: ReceivedPicture) -> SensorFrame | None:
        layout = opened.layout
        assert layout is not None
        self._check_picture(stream, layout, picture)
        num_bytes = layout.image_bytes(picture.padding)
        if picture.data.size < num_bytes:
            stream.give_back(picture.data)
            self._counter.incomplete()
            return None
        labelled = (
            opened.labels.exposure(picture.buffer, opened.commanded.gain)
            if opened.labels is not None
            else None
        )
        return SensorFrame(
            data=picture.data[:num_bytes],
            pixel_format=layout.pixel_format,
            width=picture.width,
            height=picture.height,
            row_bytes=layout.row_bytes(picture.padding),
            frame_id=self._counter.whole(picture.device_id),
            device_ns=picture.device_ns if opened.connection.ticks_per_s else None,
            arrival_ns=picture.arrival_ns,
            exposure=labelled or opened.commanded,
            is_labelled=labelled is not None,
        )

    def _check_picture(self, stream: Stream, layout: PictureLayout, picture: ReceivedPicture) -> None:
        if not picture.has_image:
            stream.give_back(picture.data)
            if self._opened is not None and self._opened.labels is not None:
                self._may_label = (
                    False  # GigE Vision 1 hides the image among the labels: open again without them
                )
            raise CaptureError(f"{self._where} sends data that is no picture; expected {layout.pixel_format}")
        expected = (layout.format_code, layout.width, layout.height)
        found = (picture.format_code, picture.width, picture.height)
        if found != expected:
            stream.give_back(picture.data)
            raise CaptureError(
                f"{self._where}: expected pictures of {layout.width} x {layout.height} pixels in {layout.pixel_format} "
                f"({layout.format_code:#010x}), found {picture.width} x {picture.height} in format {picture.format_code:#010x}; "
                "another program has changed the camera"
            )

    def _look_after(self, opened: _Opened) -> None:
        """Read temperature and clock state now and then, right after a picture: the camera answers then."""
        if time.monotonic() < opened.next_health_s:
            return
        opened.next_health_s = time.monotonic() + _HEALTH_PERIOD_S
        try:
            self._vital = opened.health.read()
        except AravisError as error:
            raise CaptureError(str(error)) from error

    def _while_stopped(self, change: Callable[[], None]) -> None:
        """Change what cameras refuse while they send."""
        opened = self._require_open()
        stream = opened.stream
        assert stream is not None

        def stop_change_start() -> None:
            refusal: CaptureError | None = None
            stream.stop()
            try:
                change()
            except CaptureError as error:
                if isinstance(error, AravisError) and error.is_timeout:
                    raise
                refusal = error
                if opened.sequencer.is_offered:
                    self._end_sequence()
            opened.commanded = opened.exposure.read()
            self._counter.restarted()
            stream.start()
            if refusal is not None:
                raise refusal

        self._asked(stop_change_start)

    def _end_sequence(self) -> None:
        self._require_open().sequencer.stop()
        self._set_rate(self._table.trigger)

    def _set_rate(self, trigger: str, pictures: int = 1) -> None:
        """So many pictures per period when running freely, as fast as can be on request; a hardware trigger has its own rate."""
        features = self._require_open().features
        if trigger == "free":
            set_frame_rate(features, pictures * self._frame_rate)
        elif trigger == "software":
            lift_frame_rate(features)

    def _require_open(self) -> _Opened:
        if self._opened is None:
            raise CaptureError(f"{self._where} is not open")
        return self._opened

    def _asked(self, question: Callable[[], _Result]) -> _Result:
        try:
            return question()
        except CaptureError as error:
            raise self._named(error) from error

    def _named(self, error: CaptureError) -> CaptureError:
        text = str(error)
        return CaptureError(text if text.startswith(self._where) else f"{self._where}: {text}")


def _describe(connection: Connection, opened: _Opened) -> dict[str, str | int | float | bool]:
    camera, layout = connection.camera, opened.layout
    return {
        "transport": camera.kind,
        "vendor": camera.vendor,
        "model": camera.model,
        "serial": camera.serial,
        **({"address": camera.address} if camera.address else {"path": camera.interface}),
        "pixel_format": layout.pixel_format if layout is not None else "",
    }

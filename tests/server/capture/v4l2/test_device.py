"""`V4l2Device` on a camera that behaves as the V4L2 specification says; the same on a real driver: tests/v4l2."""

from __future__ import annotations

import errno
import time
from typing import Any

import numpy as np
import pytest
from tests.server.capture.v4l2.scripted_kernel import (
    CAPTURE_MPLANE,
    ScriptedCamera,
    ScriptedControl,
    Shot,
)

from nearfield_server.capture.device import Exposure
from nearfield_server.capture.v4l2 import kernel_api as api
from nearfield_server.capture.v4l2.device import V4l2Device
from nearfield_server.capture.v4l2.kernel_api import ControlId
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import V4l2SourceTable

PATH = "/dev/v4l/by-id/usb-Scripted_camera-video-index0"
WAIT_S = 0.02


def device_of(camera: ScriptedCamera, *, size: tuple[int, int] = (64, 48), **keys: Any) -> V4l2Device:
    table = V4l2SourceTable(kind="v4l2", path=PATH, **{"pixel_format": "GREY", **keys})
    return V4l2Device("cam0", table, *size, 30.0, open_node=camera.open)


def exposing_camera(**options: Any) -> ScriptedCamera:
    return ScriptedCamera(
        controls=[
            ScriptedControl(
                ControlId.EXPOSURE_AUTO,
                "Auto Exposure",
                menu={1: "Manual", 3: "Aperture Priority"},
                default=3,
            ),
            ScriptedControl(
                ControlId.EXPOSURE_ABSOLUTE, "Exposure Time, Absolute", minimum=3, maximum=2047, default=250
            ),
            ScriptedControl(ControlId.GAIN, "Gain", maximum=100, default=30),
        ],
        **options,
    )


# -- opening ------------------------------------------------------------------------------------------------------------------


def test_opening_sets_the_camera_up_and_says_what_it_can() -> None:
    camera = exposing_camera()
    device = device_of(camera, exposure_s=0.01, gain_steps=[[0, 0.0], [100, 40.0]], gain_db=20.0)
    capabilities = device.open()
    assert capabilities.exposure_range_s == pytest.approx((3e-4, 0.2047))
    assert capabilities.gain_range == pytest.approx((1.0, 100.0))
    assert capabilities.device_clock
    assert not capabilities.software_trigger
    assert not capabilities.sequencer
    assert camera.control(ControlId.EXPOSURE_AUTO).value == 1
    assert camera.control(ControlId.EXPOSURE_ABSOLUTE).value == 100
    assert camera.control(ControlId.GAIN).value == 50
    assert camera.period == (1, 30)
    assert camera.num_queued == camera.num_buffers == 4
    assert device.read_exposure() == Exposure(time_s=pytest.approx(0.01), gain=pytest.approx(10.0))  # type: ignore[arg-type]
    statistics = device.statistics()
    assert statistics["model"] == "Scripted camera"
    assert statistics["path"] == PATH
    assert statistics["clock"] == "host"
    assert statistics["warnings"] == ""


def test_a_bracket_gets_buffers_for_all_its_exposures() -> None:
    camera = exposing_camera()
    device_of(camera, hdr={"mode": "bracket", "exposures_s": [0.1, 0.05, 0.02, 0.01, 0.001]}).open()
    assert camera.num_buffers == 8


def test_without_a_wish_the_drivers_default_exposure_is_set_and_an_unknown_gain_goes_to_its_least() -> None:
    camera = exposing_camera()
    camera.control(ControlId.EXPOSURE_ABSOLUTE).value = 2000  # someone else left it so
    capabilities = device_of(camera).open()
    assert camera.control(ControlId.EXPOSURE_ABSOLUTE).value == 250
    assert camera.control(ControlId.GAIN).value == 0
    assert capabilities.gain_range == (1.0, 1.0)


def test_a_gain_named_in_the_controls_stays_as_named() -> None:
    camera = exposing_camera()
    device_of(camera, controls={"gain": 42}).open()
    assert camera.control(ControlId.GAIN).value == 42


def test_an_exposure_that_the_start_of_the_stream_forgot_is_set_again() -> None:
    camera = exposing_camera()
    camera.forgets_exposure_at_start = True
    device = device_of(camera, exposure_s=0.01)
    device.open()
    assert camera.control(ControlId.EXPOSURE_ABSOLUTE).value == 100
    assert device.read_exposure().time_s == pytest.approx(0.01)


def test_a_camera_without_exposure_control_has_the_declared_exposure() -> None:
    capabilities = device_of(ScriptedCamera(), exposure_s=0.004).open()
    assert capabilities.exposure_range_s == (0.004, 0.004)
    undeclared = device_of(ScriptedCamera())
    undeclared.open()
    assert "no exposure control" in str(undeclared.statistics()["warnings"])


def test_a_sensor_in_lines_is_set_in_seconds_and_its_frame_rate_by_blanking() -> None:
    camera = ScriptedCamera(
        rates=(),
        controls=[
            ScriptedControl(ControlId.EXPOSURE, "Exposure", minimum=1, maximum=48, default=10),
            ScriptedControl(
                ControlId.PIXEL_RATE,
                "Pixel Rate",
                maximum=10**9,
                default=1_000_000,
                kind=api.ControlType.INTEGER64,
                flags=api.ControlFlag.READ_ONLY,
            ),
            ScriptedControl(ControlId.HBLANK, "Horizontal Blanking", maximum=100, default=36),
            ScriptedControl(ControlId.VBLANK, "Vertical Blanking", maximum=5000, default=4),
        ],
    )

    def limit_exposure() -> None:
        # As sensors do: no exposure is longer than a frame.
        camera.control(ControlId.EXPOSURE).maximum = 44 + int(camera.control(ControlId.VBLANK).value or 0)

    camera.after_write = limit_exposure
    device = device_of(camera, exposure_s=0.01)
    device.open()
    # Lines of 64 + 36 pixels take 100 us: 100 lines are 10 ms, and 30 frames/s are 333 lines, 48 of them shown.
    assert camera.control(ControlId.EXPOSURE).value == 100
    assert camera.control(ControlId.VBLANK).value == 333 - 48
    assert device.statistics()["warnings"] == ""


def test_an_exposure_in_unknown_units_asks_for_the_unit() -> None:
    camera = ScriptedCamera(controls=[ScriptedControl(ControlId.EXPOSURE, "Exposure", maximum=5000)])
    device = device_of(camera, exposure_s=0.01)
    device.open()
    assert "exposure_unit_s" in str(device.statistics()["warnings"])
    told = device_of(camera, exposure_s=0.01, exposure_unit_s=2e-5)
    device.close()
    told.open()
    assert camera.control(ControlId.EXPOSURE).value == 500


# -- refusals in words --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOENT, "is it plugged in"),
        (errno.EACCES, "usermod -aG"),
        (errno.EBUSY, "in use by"),
        (errno.ENODEV, "the camera is gone"),
    ],
)
def test_a_node_that_cannot_be_opened_says_why(number: int, words: str) -> None:
    camera = ScriptedCamera()
    camera.open_error = number
    with pytest.raises(CaptureError, match=rf"camera cam0 \({PATH}\): cannot open the device.*{words}"):
        device_of(camera).open()


def test_another_user_of_the_camera_is_named() -> None:
    camera = ScriptedCamera()
    device_of(camera).open()
    with pytest.raises(CaptureError, match="in use by"):
        device_of(camera).open()
    assert camera.open_nodes == 1


def test_a_full_usb_bus_says_what_to_do() -> None:
    camera = ScriptedCamera()
    camera.stream_error = errno.ENOSPC
    with pytest.raises(CaptureError, match="USB bus has no room"):
        device_of(camera).open()
    assert camera.open_nodes == 0
    assert camera.owner is None


def test_a_start_without_memory_leaves_the_queue_to_others() -> None:
    camera = ScriptedCamera()
    camera.map_error_at = 2
    with pytest.raises(CaptureError, match="no memory") as caught:
        device_of(camera).open()
    assert caught.value.__traceback__ is not None  # it keeps what was mapped alive
    assert camera.owner is None
    assert camera.open_nodes == 0


def test_a_size_or_format_that_is_not_there_lists_what_is() -> None:
    camera = ScriptedCamera(
        formats={"GREY": [(64, 48), (32, 24)], "RG12": [(64, 48)], "YUYV": [(64, 48)], "H264": [(64, 48)]}
    )
    offers = r"It offers: GREY \(64x48, 32x24\); SRGGB12, YUYV \(64x48\); not readable: H264"
    with pytest.raises(CaptureError, match=rf"expected GREY at 60x40 .* takes GREY 64x48 instead\. {offers}"):
        device_of(camera, size=(60, 40)).open()
    with pytest.raises(CaptureError, match=rf"expected UYVY at 64x48 .* takes GREY 64x48 instead\. {offers}"):
        device_of(camera, pixel_format="UYVY").open()
    assert camera.open_nodes == 0


def test_interlaced_pictures_are_refused() -> None:
    camera = ScriptedCamera()
    camera.field = 4
    with pytest.raises(CaptureError, match="interlaced"):
        device_of(camera).open()


def test_nodes_that_are_no_camera_are_refused() -> None:
    metadata = ScriptedCamera(capabilities=api.Capability.META_CAPTURE | api.Capability.STREAMING)
    with pytest.raises(CaptureError, match="video-index0"):
        device_of(metadata).open()
    with pytest.raises(CaptureError, match="captures no pictures"):
        device_of(ScriptedCamera(capabilities=api.Capability.VIDEO_CAPTURE)).open()


def test_wishes_that_cannot_be_met_name_the_limits() -> None:
    with pytest.raises(CaptureError, match=r"exposure_s: expected 0\.0003 to 0\.2047 s, found 1 s"):
        device_of(exposing_camera(), exposure_s=1.0).open()
    with pytest.raises(
        CaptureError, match=r"gain_db: expected 0, found 6: nothing says what gain \(0\.\.100"
    ):
        device_of(exposing_camera(), gain_db=6.0).open()
    with pytest.raises(CaptureError, match=r"gain_db: expected 0 to 40, found 50"):
        device_of(exposing_camera(), gain_db=50.0, gain_steps=[[0, 0.0], [100, 40.0]]).open()
    with pytest.raises(CaptureError, match="no control 'zoom'"):
        device_of(exposing_camera(), controls={"zoom": 1}).open()


def test_a_rate_that_the_camera_does_not_have_is_told() -> None:
    device = device_of(ScriptedCamera(rates=(15, 5)), exposure_s=0.01)
    device.open()
    assert device.statistics()["warnings"] == (
        "asked for 30 frames/s, the camera gives 15 at this size and format"
    )


def test_triggers_and_sequencers_are_refused() -> None:
    device = device_of(ScriptedCamera())
    device.open()
    device.use_trigger(False)
    for refused in (lambda: device.use_trigger(True), device.trigger, lambda: device.program_sequence([])):
        with pytest.raises(CaptureError, match="free_running"):
            refused()


# -- frames -------------------------------------------------------------------------------------------------------------------


def test_frames_are_views_of_the_drivers_memory_in_order() -> None:
    camera = exposing_camera(delay=0)
    device = device_of(camera, exposure_s=0.01)
    device.open()
    camera.shoot(Shot(timestamp_ns=5_000_000_000), Shot(timestamp_ns=5_033_333_000))
    first, second = device.next_frame(WAIT_S), device.next_frame(WAIT_S)
    assert first is not None
    assert second is not None
    assert (second.frame_id - first.frame_id, first.pixel_format) == (1, "Mono8")
    assert (first.width, first.height, first.row_bytes) == (64, 48, 64)
    np.testing.assert_array_equal(first.data, np.full(64 * 48, 100, np.uint8))
    # The driver stamps the end of a picture: the exposure of 10 ms began before that.
    assert first.device_ns == 5_000_000_000 - 10_000_000
    assert first.arrival_ns <= time.monotonic_ns()
    assert first.exposure == Exposure(time_s=pytest.approx(0.01))  # type: ignore[arg-type]
    assert not first.is_labelled
    camera._storage[0][0] = 77
    assert first.data[0] == 77
    assert device.next_frame(WAIT_S) is None


def test_start_stamps_are_taken_as_they_are_and_foreign_clocks_not_at_all() -> None:
    start = api.BufferFlag.TIMESTAMP_MONOTONIC | api.BufferFlag.TIMESTAMP_START_OF_EXPOSURE
    for stamps, expected in ((start, 7_000_000_000), (0, None)):
        camera = exposing_camera(stamps=stamps)
        device = device_of(camera, exposure_s=0.01)
        assert device.open().device_clock == (expected is not None)
        camera.shoot(Shot(timestamp_ns=7_000_000_000))
        frame = device.next_frame(WAIT_S)
        assert frame is not None
        assert frame.device_ns == expected
        assert ("clock" in device.statistics()) == (expected is not None)


def test_rows_keep_their_padding() -> None:
    camera = ScriptedCamera(padding=16)
    device = device_of(camera, pixel_format="SRGGB12")
    device.open()
    camera.shoot()
    frame = device.next_frame(WAIT_S)
    assert frame is not None
    assert (frame.pixel_format, frame.row_bytes, frame.data.size) == ("BayerRG12", 144, 144 * 48)


@pytest.mark.parametrize(
    ("colour", "name"),
    [
        ({}, "YUYV"),  # limited range is the default of YCbCr formats
        ({"colorspace": api.COLORSPACE_JPEG}, "YUV422_8"),
        ({"quantization": api.QUANTIZATION_FULL_RANGE}, "YUV422_8"),
        ({"colorspace": api.COLORSPACE_JPEG, "quantization": 2}, "YUYV"),
    ],
)
def test_the_range_of_luma_is_as_the_driver_says(colour: dict[str, int], name: str) -> None:
    camera = ScriptedCamera(formats={"YUYV": [(64, 48)]})
    camera.colour = colour
    device = device_of(camera, pixel_format="YUYV")
    device.open()
    camera.shoot()
    frame = device.next_frame(WAIT_S)
    assert frame is not None
    assert (frame.pixel_format, frame.row_bytes) == (name, 128)


def test_colours_of_hd_television_are_told() -> None:
    camera = ScriptedCamera(formats={"YUYV": [(64, 48)]})
    camera.colour = {"colorspace": api.COLORSPACE_REC709}
    device = device_of(camera, pixel_format="YUYV", exposure_s=0.01)
    device.open()
    assert "BT.709" in str(device.statistics()["warnings"])


def test_multi_planar_drivers_deliver_the_same() -> None:
    camera = exposing_camera(capabilities=CAPTURE_MPLANE, delay=0)
    device = device_of(camera, exposure_s=0.01)
    device.open()
    camera.shoot()
    frame = device.next_frame(WAIT_S)
    assert frame is not None
    assert frame.row_bytes == 64
    np.testing.assert_array_equal(frame.data, np.full(64 * 48, 100, np.uint8))
    camera.num_planes = 2
    device.close()
    with pytest.raises(CaptureError, match="2 pieces of memory"):
        device.open()


def test_compressed_pictures_have_their_own_length_and_begin_as_jpeg() -> None:
    camera = ScriptedCamera(formats={"MJPG": [(64, 48)]})
    device = device_of(camera, pixel_format="MJPG")
    device.open()
    camera.fill(b"\xff\xd8 a picture \xff\xd9")
    camera.fill(b"no picture at all")
    frame = device.next_frame(WAIT_S)
    assert frame is not None
    assert (frame.pixel_format, frame.row_bytes, frame.data.tobytes()) == (
        "MJPG",
        0,
        b"\xff\xd8 a picture \xff\xd9",
    )
    assert device.next_frame(WAIT_S) is None
    assert device.statistics()["frames_broken"] == 1


def test_released_buffers_go_round_and_held_ones_lose_frames() -> None:
    camera = ScriptedCamera()
    device = device_of(camera)
    device.open()
    for _ in range(3 * camera.num_buffers):
        camera.shoot()
        frame = device.next_frame(WAIT_S)
        assert frame is not None
        device.release(frame)
        device.release(frame)  # a second time does nothing
    assert camera.num_queued == camera.num_buffers
    assert device.statistics()["frames_lost"] == 0
    camera.shoot(*[Shot()] * (camera.num_buffers + 3))
    held = [device.next_frame(WAIT_S) for _ in range(camera.num_buffers)]
    assert device.next_frame(WAIT_S) is None
    for frame in held:
        assert frame is not None
        device.release(frame)
    camera.shoot()
    after = device.next_frame(WAIT_S)
    assert after is not None
    assert held[-1] is not None
    assert after.frame_id - held[-1].frame_id == 4
    assert device.statistics()["frames_lost"] == 3


def test_lost_and_broken_frames_are_counted_apart() -> None:
    camera = ScriptedCamera()
    device = device_of(camera)
    device.open()
    camera.shoot()
    camera.lose(2)
    camera.shoot(Shot(error=True), Shot(short=10), Shot())
    ids = []
    while (frame := device.next_frame(WAIT_S)) is not None:
        ids.append(frame.frame_id)
        device.release(frame)
    assert np.diff(ids).tolist() == [5]
    assert device.statistics()["frames_lost"] == 2
    assert device.statistics()["frames_broken"] == 2
    assert camera.num_queued == camera.num_buffers


def test_waiting_ends_with_the_frame_that_comes() -> None:
    camera = ScriptedCamera()
    device = device_of(camera)
    device.open()
    camera.script += [lambda: camera.shoot(Shot(error=True)), camera.shoot]
    frame = device.next_frame(30.0)
    assert frame is not None
    assert device.statistics()["frames_broken"] == 1
    assert device.next_frame(0.0) is None


# -- exposure -----------------------------------------------------------------------------------------------------------------


def test_after_the_settle_frames_every_picture_has_the_new_exposure() -> None:
    camera = exposing_camera(delay=2)
    device = device_of(camera, exposure_s=0.01)
    settle = device.open().settle_frames
    camera.shoot(Shot(), Shot(), Shot())
    first = device.next_frame(WAIT_S)
    assert first is not None
    device.release(first)
    # Two wait already when the exposure changes.
    made = device.set_exposure(Exposure(time_s=0.02004))
    assert made.time_s == pytest.approx(0.02)
    assert camera.num_queued == camera.num_buffers
    shown = []
    for _ in range(settle + 3):
        camera.shoot()
        frame = device.next_frame(WAIT_S)
        assert frame is not None
        shown.append(int(frame.data[0]))
        device.release(frame)
    assert shown[settle:] == [200, 200, 200]
    assert shown[0] == 100
    assert device.statistics()["frames_lost"] == 0


def test_exposures_beyond_the_range_are_clamped_and_told() -> None:
    camera = exposing_camera()
    device = device_of(camera)
    device.open()
    assert device.set_exposure(Exposure(time_s=9.0)).time_s == pytest.approx(0.2047)
    assert device.set_exposure(Exposure(time_s=1e-9)).time_s == pytest.approx(3e-4)


def test_an_exposure_changed_by_someone_else_is_seen() -> None:
    camera = exposing_camera()
    device = device_of(camera, exposure_s=0.01)
    device.open()
    camera.control(ControlId.EXPOSURE_ABSOLUTE).value = 500
    assert device.read_exposure().time_s == pytest.approx(0.05)


# -- faults -------------------------------------------------------------------------------------------------------------------


def test_unplugging_is_told_and_replugging_heals_with_every_setting_applied_again() -> None:
    camera = exposing_camera()
    device = device_of(camera, exposure_s=0.01, controls={"gain": 7})
    device.open()
    camera.shoot()
    before = device.next_frame(WAIT_S)
    camera.shoot()
    held = device.next_frame(WAIT_S)
    assert before is not None
    assert held is not None
    camera.script.append(camera.unplug)
    with pytest.raises(CaptureError, match="the camera is gone"):
        device.next_frame(30.0)
    with pytest.raises(CaptureError, match="the camera is gone"):
        device.set_exposure(Exposure(time_s=0.02))
    with pytest.raises(CaptureError, match="the camera is gone"):
        device.release(before)
    device.close()
    device.close()
    with pytest.raises(CaptureError, match="is it plugged in"):
        device.open()
    camera.replug()
    device.open()
    assert camera.control(ControlId.EXPOSURE_ABSOLUTE).value == 100
    assert camera.control(ControlId.GAIN).value == 7
    camera.shoot()
    after = device.next_frame(WAIT_S)
    assert after is not None
    assert after.frame_id == held.frame_id + 1
    device.release(held)  # of the stream before: ignored
    assert camera.num_queued == camera.num_buffers - 1
    assert camera.open_nodes == 1


def test_a_broken_stream_is_told() -> None:
    camera = ScriptedCamera()
    device = device_of(camera)
    device.open()
    camera.script.append(lambda: setattr(camera, "broken", True))
    with pytest.raises(CaptureError, match=r"cannot take a picture: the camera fails \(Input/output error\)"):
        device.next_frame(30.0)


def test_a_stream_that_the_driver_stops_is_told() -> None:
    camera = ScriptedCamera()
    device = device_of(camera)
    device.open()
    camera.script.append(lambda: setattr(camera, "stopped", True))
    with pytest.raises(CaptureError, match="the driver has stopped the stream"):
        device.next_frame(30.0)


def test_frames_that_are_still_referred_to_do_not_keep_the_camera_busy() -> None:
    camera = ScriptedCamera()
    device = device_of(camera)
    device.open()
    camera.shoot()
    frame = device.next_frame(WAIT_S)
    assert frame is not None
    device.close()
    assert camera.owner is None
    device.open()
    assert frame.data.size == 64 * 48  # still readable


def test_a_closed_device_says_so() -> None:
    device = device_of(ScriptedCamera())
    device.close()
    with pytest.raises(CaptureError, match="is not open"):
        device.next_frame(0.0)
    assert device.statistics()["frames_lost"] == 0

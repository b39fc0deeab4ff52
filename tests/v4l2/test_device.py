"""`V4l2Device` and discovery on a real driver: formats, order of bytes, numbers, times, controls."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from tests.v4l2.conftest import Plug, set_control

from nearfield_server.capture.device import Exposure, SensorFrame
from nearfield_server.capture.v4l2.controls import ControlSet
from nearfield_server.capture.v4l2.device import V4l2Device
from nearfield_server.capture.v4l2.discovery import list_cameras, list_frame_rates
from nearfield_server.capture.v4l2.formats import FORMATS, find_format
from nearfield_server.capture.v4l2.video_node import KernelNode
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import V4l2SourceTable

pytestmark = pytest.mark.vivid

WIDTH, HEIGHT = 320, 180
PATIENCE_S = 60.0
RED, NO_TEXT = 7, 2
OFFERED = [
    "GREY",
    "Y10",
    "Y12",
    "Y16",
    "RGB24",
    "BGR24",
    "YUYV",
    "UYVY",
    *(f"S{phase}{bits}" for phase in ("RGGB", "GRBG", "GBRG", "BGGR") for bits in (8, 10, 12, 16)),
]


def device_on(
    path: str, *, size: tuple[int, int] = (WIDTH, HEIGHT), rate: float = 30.0, **keys: Any
) -> V4l2Device:
    table = V4l2SourceTable(kind="v4l2", path=path, **{"pixel_format": "GREY", "exposure_s": 0.01, **keys})
    return V4l2Device("cam0", table, *size, rate)


@contextmanager
def opened(device: V4l2Device) -> Iterator[V4l2Device]:
    try:
        device.open()
        yield device
    finally:
        device.close()


def take(device: V4l2Device) -> SensorFrame:
    frame = device.next_frame(PATIENCE_S)
    assert frame is not None
    return frame


def test_cameras_are_found_with_all_that_they_offer(plug: Plug) -> None:
    found = [camera for camera in list_cameras() if camera.driver == "vivid"]
    assert len(found) == len(plug.paths) >= 2
    for camera in found:
        assert camera.problem == ""
        readable = {choice.name: choice for choice in camera.formats if choice.known}
        assert set(OFFERED) <= set(readable)
        assert any(size.holds(WIDTH, HEIGHT) for size in readable["GREY"].sizes)
        assert 30.0 in list_frame_rates(camera.path, readable["GREY"], WIDTH, HEIGHT)


def red_pixels(name: str, frame: SensorFrame) -> tuple[np.ndarray, float]:
    """The codes of a frame as (H, W) or (H, W, bytes of a pixel), and the largest code; laid out as V4L2 documents the format."""
    known = find_format(name)
    rows = frame.data[: HEIGHT * frame.row_bytes].reshape(HEIGHT, frame.row_bytes)
    bits = int("".join(filter(str.isdigit, name)) or 8)
    if name in ("RGB24", "BGR24"):
        return rows[:, : 3 * WIDTH].reshape(HEIGHT, WIDTH, 3), 255.0
    if known.bits_per_pixel == 8 or name in ("YUYV", "UYVY"):
        return rows[:, : known.row_bytes(WIDTH)], 255.0
    return rows[:, : 2 * WIDTH].copy().view("<u2"), float(2**bits - 1)


@pytest.mark.parametrize("name", OFFERED)
def test_a_red_picture_is_red_in_every_format(plug: Plug, name: str) -> None:
    path = plug.paths[
        len(name) % 2
    ]  # some from the camera with one plane, some from that with a list of planes
    with opened(
        device_on(path, pixel_format=name, controls={"test_pattern": RED, "osd_text_mode": NO_TEXT})
    ) as device:
        frame = take(device)
        assert frame.pixel_format == find_format(name).pixel_format
        codes, top = red_pixels(name, frame)
        if name in ("RGB24", "BGR24"):
            expected = [255, 0, 0] if name == "RGB24" else [0, 0, 255]
            np.testing.assert_array_equal(codes, np.broadcast_to(expected, codes.shape))
        elif name in ("YUYV", "UYVY"):
            # ITU-R BT.601: 100 % red is Y 81, Cb 90, Cr 240; the driver may round down.
            luma, cb, cr = (
                (codes[:, 0::2], codes[:, 1::4], codes[:, 3::4])
                if name == "YUYV"
                else (codes[:, 1::2], codes[:, 0::4], codes[:, 2::4])
            )
            for values, target in ((luma, 81), (cb, 90), (cr, 240)):
                assert np.abs(values.astype(int) - target).max() <= 1
        elif name.startswith("S"):
            site = name[1:5].index("R")
            for index, (row, column) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
                assert set(np.unique(codes[row::2, column::2])) == {top if index == site else 0}
        else:
            # Rec. 709 luma of red is 0.2126 of the range.
            assert np.abs(codes / top - 0.2126).max() < 0.01


def test_every_frame_is_numbered_and_dated(plug: Plug) -> None:
    ids, starts = [], []
    before_ns = time.monotonic_ns()
    with opened(device_on(plug.paths[0])) as device:
        for _ in range(12):
            frame = take(device)
            assert frame.device_ns is not None
            # The clock of this machine. The driver makes a picture at once, and stamps it with the end that its transfer would have.
            end_ns = frame.device_ns + 10_000_000
            assert before_ns < end_ns < frame.arrival_ns + 1e9 / 30
            ids.append(frame.frame_id)
            starts.append(frame.device_ns)
            device.release(frame)
        statistics = device.statistics()
    steps = np.diff(ids)
    assert (steps >= 1).all()
    assert statistics["frames_lost"] == int(
        (steps - 1).sum()
    )  # a busy machine may lose some, and then says so
    assert (np.diff(starts) > 0).all()
    # The driver counts 30 pictures a second of its time, whatever the load; twice the rate would be a wrong unit.
    assert 0.5 < (starts[-1] - starts[0]) / (ids[-1] - ids[0]) / (1e9 / 30) < 2.0
    assert statistics["clock"] == "host"
    assert (statistics["model"], statistics["driver"]) == ("vivid", "vivid")


def test_numbers_go_on_where_the_driver_wraps_them(plug: Plug) -> None:
    with opened(device_on(plug.paths[0], rate=60.0, controls={"wrap_sequence_number": 1})) as device:
        ids = []
        for _ in range(150):  # the driver begins 128 before the wrap
            frame = take(device)
            ids.append(frame.frame_id)
            device.release(frame)
        assert ids[-1] - ids[0] == len(ids) - 1 + int(device.statistics()["frames_lost"])
    set_control(plug.paths[0], "wrap_sequence_number", 0)


def test_dropped_and_damaged_frames_are_counted(plug: Plug) -> None:
    with opened(device_on(plug.paths[0])) as device:
        device.release(take(device))
        set_control(plug.paths[0], "percentage_of_dropped_buffers", 60)
        ids = []
        for _ in range(20):
            frame = take(device)
            ids.append(frame.frame_id)
            device.release(frame)
        lost = device.statistics()["frames_lost"]
        # At 60 % twenty frames without a gap have a chance of 1e-8.
        assert lost > 0
        assert ids[-1] - ids[0] >= 20
        set_control(plug.paths[0], "percentage_of_dropped_buffers", 0)
        set_control(plug.paths[0], "inject_v4l2_buf_flag_error")
        for _ in range(30):
            device.release(take(device))
            if device.statistics()["frames_broken"]:
                break
        assert device.statistics()["frames_broken"] == 1
        device.release(take(device))


def test_a_slow_reader_loses_frames_but_none_is_torn_or_repeated(plug: Plug) -> None:
    with opened(device_on(plug.paths[0])) as device:
        held = [take(device) for _ in range(int(device.statistics()["buffers"]))]
        assert device.next_frame(0.2) is None  # the driver has no buffer left
        pictures = [frame.data.copy() for frame in held]
        for frame, picture in zip(held, pictures, strict=True):
            np.testing.assert_array_equal(frame.data, picture)
            device.release(frame)
        assert take(device).frame_id > held[-1].frame_id


def test_gain_is_set_in_decibels_and_automatics_are_off(plug: Plug) -> None:
    device = device_on(plug.paths[0], gain_steps=[[0, 0.0], [255, 51.0]], gain_db=20.0)
    with opened(device):
        node = KernelNode(plug.paths[0])
        try:
            controls = ControlSet(node)
            assert controls.get(controls.named("gain_automatic")) == 0
            assert controls.get(controls.named("gain")) == 100
            made = device.set_exposure(Exposure(time_s=0.01, gain=100.0))
            assert controls.get(controls.named("gain")) == 200
            assert made.gain == pytest.approx(100.0)
            controls.set(controls.named("gain"), 50)  # someone else
            assert device.read_exposure().gain == pytest.approx(10 ** (10 / 20))
        finally:
            node.close()


def test_picture_controls_are_reset_at_every_start_and_named_ones_set(plug: Plug) -> None:
    set_control(plug.paths[1], "brightness", 3)
    set_control(plug.paths[1], "contrast", 3)
    with opened(device_on(plug.paths[1], controls={"contrast": 77, "menu": 4})):
        node = KernelNode(plug.paths[1])
        try:
            controls = ControlSet(node)
            values = [controls.get(controls.named(name)) for name in ("brightness", "contrast", "menu")]
        finally:
            node.close()
    assert values == [128, 77, 4]


def test_wishes_that_the_driver_refuses_are_explained(plug: Plug) -> None:
    with pytest.raises(
        CaptureError,
        match=r"expected GREY at 333x222 .* takes GREY \d+x\d+ instead\. It offers: .*GREY.*320x180",
    ):
        device_on(plug.paths[0], size=(333, 222)).open()
    with pytest.raises(CaptureError, match=r"expected MJPEG at 320x180"):
        device_on(plug.paths[0], pixel_format="MJPG").open()
    with pytest.raises(CaptureError, match=r"menu: the camera refuses 2; there are: 1 = .*"):
        device_on(plug.paths[0], controls={"menu": 2}).open()
    with pytest.raises(CaptureError, match="read_only_integer_32_bits is read-only"):
        device_on(plug.paths[0], controls={"read_only_integer_32_bits": 2}).open()
    with opened(device_on(plug.paths[0], rate=7.0)) as device:
        assert "asked for 7 frames/s, the camera gives" in str(device.statistics()["warnings"])


def test_two_cameras_deliver_side_by_side(plug: Plug) -> None:
    with (
        opened(device_on(plug.paths[0])) as first,
        opened(device_on(plug.paths[1], pixel_format="SRGGB12")) as second,
    ):
        for _ in range(5):
            for device, name in ((first, "Mono8"), (second, "BayerRG12")):
                frame = take(device)
                assert frame.pixel_format == name
                device.release(frame)


def test_the_list_of_readable_formats_is_wholly_tried_here() -> None:
    """MIPI packing, 14 bits and JPEG are those that vivid does not offer."""
    untried = {known.usual_name for known in FORMATS} - set(OFFERED)
    assert all("14" in name or name.endswith("P") or "JPEG" in name for name in untried)

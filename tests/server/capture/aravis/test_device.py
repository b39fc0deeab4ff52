"""A camera through libaravis: settings, pictures, losses, faults. The other side is a camera written after the standard, in a thread."""

from __future__ import annotations

import math
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.network_namespace import camera_address
from tests.server.capture.aravis.gige_camera import (
    BAYER_RG12P,
    HEARTBEAT,
    MONO8,
    MONO16,
    GigeCamera,
    describe,
    enumeration,
    integer,
)

from nearfield_server.capture.aravis import connection, device, health, receive_buffer, stream
from nearfield_server.capture.aravis.control_claim import claims_folder
from nearfield_server.capture.aravis.device import AravisDevice
from nearfield_server.capture.aravis.discovery import find_by_serial, list_cameras, list_usb_cameras
from nearfield_server.capture.aravis.gvcp import discovery_command
from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import AravisSourceTable

pytestmark = pytest.mark.cameras
WIDTH, HEIGHT = 64, 32
PATIENCE_S = 20.0


def table(address: str, **keys: Any) -> AravisSourceTable:
    """With so many buffers that nothing is lost when the machine is busy with something else."""
    keys = {"pixel_format": "Mono8", "region": (0, 0, WIDTH, HEIGHT), "num_buffers": 32, **keys}
    return AravisSourceTable.model_validate({"kind": "aravis", "address": address, **keys})


@pytest.fixture(autouse=True)
def claims(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Ports of the tests are not mixed with those of the user's own cameras."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return claims_folder()


@pytest.fixture
def address() -> str:
    return camera_address(90)


@pytest.fixture
def camera(address: str) -> Iterator[GigeCamera]:
    with GigeCamera(address) as camera:
        yield camera


class Opened:
    """An open device, closed at the end whatever happens."""

    def __init__(self, settings: AravisSourceTable, frame_rate: float = 50.0) -> None:
        self.device = AravisDevice("fish-0", settings, WIDTH, HEIGHT, frame_rate)

    def __enter__(self) -> AravisDevice:
        self.capabilities: DeviceCapabilities = self.device.open()
        return self.device

    def __exit__(self, *_: object) -> None:
        self.device.close()


def next_frame(opened: AravisDevice) -> SensorFrame:
    frame = opened.next_frame(PATIENCE_S)
    assert frame is not None, "no picture came"
    return frame


def take(opened: AravisDevice, count: int) -> list[tuple[int, bytes]]:
    """Number and content of so many pictures, given back at once."""
    found = []
    for _ in range(count):
        frame = next_frame(opened)
        found.append((frame.frame_id, frame.data.tobytes()))
        opened.release(frame)
    return found


def failure(settings: AravisSourceTable) -> str:
    """Words of the error with which a camera does not open."""
    opened = AravisDevice("fish-0", settings, WIDTH, HEIGHT, 50.0)
    with pytest.raises(CaptureError) as caught:
        opened.open()
    opened.close()
    assert str(caught.value).startswith("camera fish-0")
    return str(caught.value)


def wait_for_releases() -> None:
    """Wait until what closed devices still give back in the background is given back."""
    for thread in threading.enumerate():
        if thread.name == "aravis-release":
            thread.join(PATIENCE_S)


# Pictures


def test_pictures_arrive_whole_and_in_order(camera: GigeCamera, address: str) -> None:
    with Opened(table(address, exposure_s=0.004)) as opened:
        pictures = take(opened, 5)
        statistics = opened.statistics()
    start = pictures[0][1][0]
    for step, (number, content) in enumerate(pictures):
        assert number == pictures[0][0] + step
        assert content == camera.picture_bytes((start + step) % 256)[: WIDTH * HEIGHT]
    assert statistics["frames_lost"] == statistics["frames_broken"] == 0
    assert (statistics["vendor"], statistics["model"], statistics["serial"]) == (
        "Test Cameras",
        "T100",
        address,
    )


@pytest.mark.parametrize(
    ("pixel_format", "code", "num_bytes", "row_bytes"),
    [
        ("Mono8", MONO8, WIDTH * HEIGHT, WIDTH),
        ("Mono16", MONO16, 2 * WIDTH * HEIGHT, 2 * WIDTH),
        ("BayerRG12p", BAYER_RG12P, WIDTH * HEIGHT * 3 // 2, 0),
    ],
)
def test_formats_have_their_sizes(
    camera: GigeCamera, address: str, pixel_format: str, code: int, num_bytes: int, row_bytes: int
) -> None:
    with Opened(table(address, pixel_format=pixel_format)) as opened:
        frame = next_frame(opened)
    assert camera.values["PixelFormat"] == code
    assert (frame.pixel_format, frame.width, frame.height) == (pixel_format, WIDTH, HEIGHT)
    assert (frame.data.size, frame.row_bytes) == (num_bytes, row_bytes)


def test_pictures_are_views_of_the_memory_they_were_received_in(camera: GigeCamera, address: str) -> None:
    with Opened(table(address, num_buffers=3)) as opened:
        received = opened._opened
        assert received is not None
        assert received.stream is not None
        memory = received.stream.memory
        for _ in range(2 * len(memory)):
            frame = next_frame(opened)
            assert np.shares_memory(frame.data, memory)
            opened.release(frame)
            opened.release(frame)  # twice does no harm: the buffer is pushed once
        kept = next_frame(opened)
        content = kept.data.copy()
    opened.release(kept)  # after the end
    assert np.array_equal(kept.data, content)  # and the memory outlives the stream


def test_buffers_that_are_not_given_back_stop_the_camera_not_the_process(
    camera: GigeCamera, address: str
) -> None:
    with Opened(table(address, num_buffers=2)) as opened:
        kept = [next_frame(opened) for _ in range(2)]
        assert opened.next_frame(0.2) is None
        assert opened.statistics()["packets_without_buffer"] > 0  # type: ignore[operator]
        for frame in kept:
            opened.release(frame)
        later = next_frame(opened)
    assert later.frame_id > kept[-1].frame_id + 1
    assert opened.statistics()["frames_lost"] == later.frame_id - kept[-1].frame_id - 1


def test_times_are_the_cameras_and_ours(camera: GigeCamera, address: str) -> None:
    with Opened(table(address)) as opened:
        before_ns = time.monotonic_ns()
        frames = [next_frame(opened) for _ in range(3)]
        after_ns = time.monotonic_ns()
    for frame in frames[1:]:  # this camera's clock is the host's
        assert frame.device_ns is not None
        assert before_ns - 10**9 < frame.device_ns <= frame.arrival_ns <= after_ns


@pytest.mark.parametrize(("with_long_ids", "first"), [(False, 65533), (True, 65533), (True, 1 << 40)])
def test_numbers_go_on_where_the_camera_wraps(address: str, with_long_ids: bool, first: int) -> None:
    with GigeCamera(address, with_long_ids=with_long_ids, first_id=first) as camera:
        with Opened(table(address)) as opened:
            numbers = [number for number, _ in take(opened, 6)]
            statistics = opened.statistics()
        assert (camera.next_id < 10) == (not with_long_ids)
    assert np.all(np.diff(numbers) == 1)
    assert statistics["frames_lost"] == 0


def test_broken_and_lost_pictures_are_counted_apart(camera: GigeCamera, address: str) -> None:
    camera.is_lost = lambda picture, packet: (
        picture % 8 == 3  # nothing comes of it
        or (picture % 8 == 5 and packet == 1)  # a hole
        or (picture % 8 == 6 and packet == 0)  # no leader: neither size nor format is known
    )
    with Opened(table(address)) as opened:
        found = take(opened, 16)
        statistics = opened.statistics()
    assert all(content == camera.picture_bytes(content[0])[: WIDTH * HEIGHT] for _, content in found)
    whole, span = len(found), found[-1][0] - found[0][0] + 1
    assert (statistics["frames_lost"], statistics["frames_broken"]) == (
        sum(1 for step in range(span) if (found[0][1][0] + step) % 8 == 3),
        sum(1 for step in range(span) if (found[0][1][0] + step) % 8 in (5, 6)),
    )
    assert span == whole + statistics["frames_lost"] + statistics["frames_broken"]  # type: ignore[operator]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sent_format": MONO16}, r"in Mono8 \(0x01080001\), found 64 x 32 in format 0x01100007"),
        ({"sent_size": (32, 32)}, "found 32 x 32"),
        ({"sent_size": (64, 0xFFFFFFFF)}, "found 64 x -1"),
        ({"payload_type": 4}, "sends data that is no picture"),
    ],
)
def test_pictures_of_another_kind_are_refused(
    camera: GigeCamera, address: str, change: dict[str, Any], message: str
) -> None:
    with Opened(table(address)) as opened:
        take(opened, 1)
        for name, value in change.items():
            setattr(camera, name, value)
        with pytest.raises(CaptureError, match=message):
            take(opened, 30)


# Settings


def test_settings_are_applied_in_order_and_again_after_a_reconnect(camera: GigeCamera, address: str) -> None:
    settings = table(
        address,
        exposure_s=0.004,
        gain_db=6.0,
        binning=2,
        region=(8, 4, WIDTH, HEIGHT),
        features={"UserSetLoad": True, "ReverseX": True, "BlackLevel": 12.5},
    )
    expected = {
        **{"ExposureTime": 4000.0, "Gain": 6.0, "BlackLevel": 12.5, "ReverseX": 1, "ExposureAuto": 0},
        **{
            "BinningHorizontal": 2,
            "BinningVertical": 2,
            "Width": WIDTH,
            "Height": HEIGHT,
            "OffsetX": 8,
            "OffsetY": 4,
        },
        **{"AcquisitionFrameRate": 50.0, "TriggerMode": 0},
    }
    opened = AravisDevice("fish-0", settings, WIDTH, HEIGHT, 50.0)
    for _ in range(2):
        opened.open()
        take(opened, 2)
        assert {name: camera.values[name] for name in expected} == pytest.approx(expected)
        order = [name for name in camera.writes if name in settings.features]
        assert order == list(settings.features)
        opened.close()
        camera.forget()
        camera.writes.clear()


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ({"Gian": 3.0}, r"has no feature Gian; did you mean Gain\?"),
        ({"Gain": 99.0}, "feature Gain cannot be 99.0; expected 0 to 40"),
        (
            {"Gain": "high"},
            'feature Gain is of type float, it cannot be "high"; expected a number from 0 to 40',
        ),
        ({"Width": 66}, "feature Width cannot be 66; it goes in steps of 4: 64 or 68"),
        (
            {"TriggerSource": "Line7"},
            'feature TriggerSource cannot be "Line7"; expected one of Software, Line1',
        ),
        ({"TriggerSource": 1}, "of type enumeration"),
        (
            {"ReverseX": "yes"},
            'feature ReverseX is of type boolean, it cannot be "yes"; expected true or false',
        ),
        ({"Lines": 3}, "feature Lines cannot be set to 3"),
        ({"UserSetLoad": 1}, "of type command"),
        ({"a\x1b[2Jb": 1}, r"has no feature a\?\[2Jb"),
    ],
)
def test_a_wrong_feature_is_told_with_what_it_would_take(
    camera: GigeCamera, address: str, features: dict[str, Any], message: str
) -> None:
    with pytest.raises(CaptureError, match=message):
        AravisDevice("fish-0", table(address, features=features), WIDTH, HEIGHT, 50.0).open()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"pixel_format": "BayerRG16"}, "expected one of Mono8, Mono16, BayerRG12p"),
        ({"exposure_s": 5.0}, "the camera made 1 s"),
        ({"gain_db": 50.0}, "the camera made"),
        ({"binning": 4}, "BinningHorizontal cannot be 4"),
        ({"region": (2, 0, WIDTH, HEIGHT)}, "steps of 4"),
        ({"region": (0, 0, 128, HEIGHT)}, "calibrated size"),
        (
            {"region": None},
            r"whole picture has 256 x 256 pixels, its calibration 64 x 32; .*region = \[x, y, 64, 32\]",
        ),
    ],
)
def test_a_wrong_key_is_told_with_what_it_would_take(
    camera: GigeCamera, address: str, keys: dict[str, Any], message: str
) -> None:
    with pytest.raises(CaptureError, match=message):
        AravisDevice("fish-0", table(address, **keys), WIDTH, HEIGHT, 50.0).open()
    assert not camera.is_streaming


def test_exposures_are_rounded_by_the_device_and_told(camera: GigeCamera, address: str) -> None:
    opening = Opened(table(address))
    with opening as opened:
        assert opening.capabilities.exposure_range_s == pytest.approx((1e-5, 1.0))
        assert opening.capabilities.gain_range == pytest.approx((1.0, 100.0))
        assert opened.set_exposure(Exposure(time_s=0.002, gain=2.0)) == opened.read_exposure()
        assert camera.values["ExposureTime"] == pytest.approx(2000.0)
        assert camera.values["Gain"] == pytest.approx(20.0 * math.log10(2.0))
        assert opened.set_exposure(Exposure(time_s=99.0)).time_s == pytest.approx(1.0)
        camera.values["ExposureTime"] = 123.0  # someone else
        assert opened.read_exposure().time_s == pytest.approx(123e-6)


def test_a_rate_beyond_the_cameras_is_a_warning(camera: GigeCamera, address: str) -> None:
    with Opened(table(address), frame_rate=500.0) as opened:
        assert "frame rate 500 Hz asked, the camera made 200 Hz of it" in str(opened.statistics()["warnings"])


def test_pictures_on_request(camera: GigeCamera, address: str) -> None:
    opening = Opened(table(address, trigger="software"))
    with opening as opened:
        assert opening.capabilities.software_trigger
        assert opened.next_frame(0.1) is None
        for _ in range(3):
            opened.trigger()
            take(opened, 1)
        assert opened.next_frame(0.0) is None
        assert camera.values["AcquisitionFrameRate"] == 200.0  # no limit to requests
        opened.use_trigger(False)
        assert camera.values["AcquisitionFrameRate"] == 50.0
        take(opened, 3)
        opened.use_trigger(True)
        opened.trigger()
        take(opened, 1)
        assert opened.statistics()["frames_lost"] == 0


def test_a_hardware_trigger_leaves_the_source_to_the_features(camera: GigeCamera, address: str) -> None:
    settings = table(address, trigger="hardware", features={"TriggerSource": "Line1"})
    with Opened(settings) as opened:
        assert (camera.values["TriggerMode"], camera.values["TriggerSource"]) == (1, 1)
        assert opened.next_frame(0.1) is None


# Labels and sequences


def test_pictures_say_how_they_were_exposed(camera: GigeCamera, address: str) -> None:
    opening = Opened(table(address, exposure_s=0.004, gain_db=6.0))
    with opening as opened:
        assert opening.capabilities.labels_exposure
        frame = next_frame(opened)
        assert frame.is_labelled
        assert (frame.exposure.time_s, frame.exposure.gain) == pytest.approx((0.004, 10**0.3))
        assert frame.data.size == WIDTH * HEIGHT  # without the labels
        opened.release(frame)
        camera.values["ExposureTime"] = 77.0  # behind our back: the label tells
        for _ in range(100):
            frame = next_frame(opened)
            opened.release(frame)
            if frame.exposure.time_s == pytest.approx(77e-6):
                break
        else:
            pytest.fail("the label never changed")


def test_a_label_that_cannot_be_is_no_label(camera: GigeCamera, address: str) -> None:
    with Opened(table(address, exposure_s=0.004)) as opened:
        camera.values["ExposureTime"] = math.nan
        for _ in range(100):
            frame = next_frame(opened)
            opened.release(frame)
            if not frame.is_labelled:
                break
        else:
            pytest.fail("NaN was taken for a label")
        assert frame.exposure.time_s == pytest.approx(0.004)  # as commanded


def test_a_sequence_cycles_and_ends(camera: GigeCamera, address: str) -> None:
    exposures = [Exposure(time_s=0.001 * 4**index, gain=1.0) for index in range(3)]
    opening = Opened(table(address))
    with opening as opened:
        assert opening.capabilities.sequencer
        assert opened.program_sequence(exposures) == pytest.approx(exposures)
        times = []
        for _ in range(9):
            frame = next_frame(opened)
            assert frame.is_labelled
            times.append(frame.exposure.time_s)
            opened.release(frame)
        assert times == pytest.approx([0.001, 0.004, 0.016] * 3)
        assert camera.values["AcquisitionFrameRate"] == 150.0  # 50 whole sequences per second
        opened.set_exposure(Exposure(time_s=0.01))
        assert next_frame(opened).exposure.time_s == pytest.approx(0.01)
        with pytest.raises(CaptureError, match="has 4 sets; expected at most so many exposures, found 5"):
            opened.program_sequence([Exposure(time_s=0.001)] * 5)
        assert camera.values["SequencerMode"] == 0
        assert camera.values["AcquisitionFrameRate"] == 50.0
        take(opened, 1)  # it goes on as before


def test_a_camera_without_labels_goes_without(address: str) -> None:
    xml = describe().replace(b'Name="ChunkModeActive"', b'Name="Unused"')
    with GigeCamera(address, xml):
        opening = Opened(table(address, exposure_s=0.004))
        with opening as opened:
            assert not opening.capabilities.labels_exposure
            assert not opening.capabilities.sequencer  # nothing would tell its pictures apart
            frame = next_frame(opened)
            assert not frame.is_labelled
            assert frame.exposure.time_s == pytest.approx(0.004)


# Well-being


def test_temperature_and_clock_are_told(
    camera: GigeCamera, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(device, "_HEALTH_PERIOD_S", 0.0)
    with Opened(table(address, features={"PtpEnable": True})) as opened:
        take(opened, 1)
        statistics = opened.statistics()
        assert (statistics["temperature_c"], statistics["ptp_status"], statistics["ptp_offset_ns"]) == (
            41.5,
            "Slave",
            250,
        )
        camera.values["DeviceTemperature"] = math.nan
        take(opened, 3)
        assert "temperature_c" not in opened.statistics()


def test_a_camera_without_a_thermometer_tells_no_temperature(address: str) -> None:
    xml = describe().replace(b"DeviceTemperature", b"Unknown")
    with (
        GigeCamera(address, xml.replace(b"UnknownReg", b"DeviceTemperatureReg")),
        Opened(table(address)) as opened,
    ):
        take(opened, 1)
        assert not {"temperature_c", "ptp_status"} & opened.statistics().keys()
    assert health._PTP_NAMES[0][0] == "PtpEnable"


def test_a_small_receive_buffer_is_a_warning(
    camera: GigeCamera, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "can_open_packet_sockets", lambda: False)  # as without CAP_NET_RAW
    with Opened(table(address)) as opened:
        granted = opened.statistics()["receive_buffer_bytes"]
        assert isinstance(granted, int)
        assert granted >= receive_buffer.wanted_bytes(WIDTH * HEIGHT)
        assert "warnings" not in opened.statistics()
    monkeypatch.setattr(stream, "enlarge_receive_buffer", lambda port, wanted: 4000)
    with Opened(table(address)) as opened:
        assert "receive buffer of 4000 bytes" in str(opened.statistics()["warnings"])
        assert "sysctl -w net.core.rmem_max" in str(opened.statistics()["warnings"])


# Faults


def test_a_camera_that_is_not_there(address: str) -> None:
    assert "no camera answers" in failure(table(address))
    assert "check power, cable" in failure(table(camera_address(91)))


def test_what_answers_may_be_no_camera(address: str) -> None:
    with GigeCamera(address) as camera:
        camera.is_answering = False
        assert "no camera answers" in failure(table(address))


def test_a_second_program_is_refused_and_the_first_keeps_its_camera(camera: GigeCamera, address: str) -> None:
    with Opened(table(address)) as opened:
        take(opened, 1)
        assert "another program controls the camera" in failure(table(address))
        take(opened, 3)


def test_a_program_that_died_need_not_be_waited_for(camera: GigeCamera, address: str) -> None:
    code = f"""
import time
from nearfield_server.capture.aravis.device import AravisDevice
from nearfield_server.scene.device_schema import AravisSourceTable
table = AravisSourceTable(kind="aravis", address="{address}", pixel_format="Mono8", region=(0, 0, {WIDTH}, {HEIGHT}))
device = AravisDevice("first", table, {WIDTH}, {HEIGHT}, 50.0)
device.open()
print("open", flush=True)
time.sleep(600)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, env=environment) as first:
        try:
            assert first.stdout is not None
            assert first.stdout.readline() == b"open\n"
            camera.registers[HEARTBEAT] = 600_000  # it would obey the dead for ten minutes
            assert "another program controls the camera" in failure(table(address))  # while it lives
        finally:
            first.kill()
    with Opened(table(address)) as opened:
        take(opened, 1)


def test_a_camera_that_another_takes_over_is_lost(camera: GigeCamera, address: str) -> None:
    with Opened(table(address)) as opened:
        take(opened, 1)
        camera.registers[0xA00] = 0  # the heartbeat reads here that control is gone
        camera.is_streaming = False
        with pytest.raises(CaptureError, match="is lost"):
            take(opened, 100)
        opened.close()
        assert opened.statistics()["frames_received"] >= 1  # type: ignore[operator]


def test_a_dead_camera_is_closed_within_a_second_and_opened_again(camera: GigeCamera, address: str) -> None:
    opened = AravisDevice("fish-0", table(address), WIDTH, HEIGHT, 50.0)
    opened.open()
    take(opened, 1)
    camera.is_answering = False
    while (frame := opened.next_frame(0.1)) is not None:  # what had been sent
        opened.release(frame)
    opened.close()
    opened.close()
    assert "aravis-release" in [
        thread.name for thread in threading.enumerate()
    ]  # it waits for the camera; we did not
    camera.forget()
    camera.is_answering = True
    deadline_s = time.monotonic() + PATIENCE_S
    while True:  # the old connection may hold the camera until it is given back
        try:
            opened.open()
            break
        except CaptureError:
            assert time.monotonic() < deadline_s
    take(opened, 2)
    opened.close()


def test_a_failed_opening_gives_the_camera_back(camera: GigeCamera, address: str) -> None:
    failure(table(address, features={"Gain": 99.0}))
    deadline_s = time.monotonic() + PATIENCE_S
    while camera.controller is not None:
        assert time.monotonic() < deadline_s, "control was kept"
        time.sleep(0.01)
    with Opened(table(address)) as opened:
        take(opened, 1)


# Strangers


def test_opening_by_address_asks_nobody_else(camera: GigeCamera, address: str) -> None:
    with Opened(table(address)) as opened:
        take(opened, 1)
    assert camera.broadcasts == 0
    list_cameras("lo", 0.1)
    assert camera.broadcasts > 0  # it would have heard


def test_no_other_interface_hears_the_search(address: str) -> None:
    ip = shutil.which("ip") or "/usr/sbin/ip"
    for words in (
        "link add searched type veth peer name listener",
        "address add 10.209.0.1/24 dev searched",
        "link set searched up",
        "link set listener up",
    ):
        subprocess.run([ip, *words.split()], check=True)
    try:
        with socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(0x0800)) as cable:  # IPv4 alone
            cable.bind(("listener", 0x0800))
            cable.settimeout(0.3)
            list_cameras("lo", 0.2)
            list_usb_cameras()
            with pytest.raises(TimeoutError):
                cable.recv(2048)
            assert list_cameras("searched", 0.2) == []
            heard = cable.recv(2048)  # the question itself: it would have been heard
            assert heard.endswith(discovery_command())
            assert heard[16:20] == b"\xff\xff\xff\xff"
    finally:
        subprocess.run([ip, "link", "delete", "searched"], check=True)


def test_cameras_are_found_by_serial_on_the_named_interface(camera: GigeCamera, address: str) -> None:
    assert find_by_serial(address, "lo").model == "T100"
    settings = AravisSourceTable.model_validate(
        {
            "kind": "aravis",
            "serial": address,
            "interface": "lo",
            "pixel_format": "Mono8",
            "region": (0, 0, WIDTH, HEIGHT),
        }
    )
    with Opened(settings) as opened:
        take(opened, 1)


HOSTILE: dict[str, tuple[bytes | None, bytes | None, str]] = {
    "file": (None, b"File:///etc/passwd", "in its own memory"),
    "network": (None, b"http://127.0.0.1/camera.xml", "in its own memory"),
    "huge": (None, b"Local:a.xml;100000;ffffffff", "at most"),
    "no XML": (b"GIF89a", None, "is no XML"),
    "bomb": (
        b'<!DOCTYPE a [<!ENTITY b "cc"><!ENTITY c "&b;&b;">]><RegisterDescription/>',
        None,
        "document type",
    ),
    "circle": (
        describe(
            '<Integer Name="A"><pValue>B</pValue></Integer><Integer Name="B"><pValue>A</pValue></Integer>'
        ),
        None,
        "from itself",
    ),
    "long register": (
        describe('<StringReg Name="S"><Address>0</Address><Length>0x7fffffffffff</Length></StringReg>'),
        None,
        "registers of at most",
    ),
    "huge payload": (
        describe('<Integer Name="PayloadSize"><Value>0x7fffffffff</Value></Integer>'),
        None,
        "payload",
    ),
    "tiny payload": (describe('<Integer Name="PayloadSize"><Value>-1</Value></Integer>'), None, "payload"),
    "range of nothing": (
        describe('<Float Name="ExposureTime"><Value>5</Value><Min>nan</Min><Max>nan</Max></Float>'),
        None,
        "expected a range of ExposureTime",
    ),
    "turned range": (
        describe('<Float Name="ExposureTime"><Value>5</Value><Min>9</Min><Max>-9</Max></Float>'),
        None,
        "expected a range of ExposureTime",
    ),
    "endless exposure": (
        describe('<Float Name="ExposureTime"><Value>1e308</Value><Min>0</Min><Max>1e308</Max></Float>'),
        None,
        "says that it exposes",
    ),
    "names with commands": (
        describe(enumeration("PixelFormat", {"\u009b2J\u202e": 1})),
        None,
        r"expected one of \?2J\?",
    ),
    "format of no bits": (
        describe(enumeration("PixelFormat", {"Mono8": 0})),
        None,
        r"the camera's number for it \(0x00000000\) says 0",
    ),
    "empty description": (b"<RegisterDescription/>", None, "has no feature"),
    "too small": (describe(integer("Width", 8, 16)), None, "Width cannot be 64"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_description_is_refused_in_words(address: str, name: str) -> None:
    xml, url, message = HOSTILE[name]
    with GigeCamera(address, xml, url), pytest.raises(CaptureError, match=message) as caught:
        AravisDevice("fish-0", table(address), WIDTH, HEIGHT, 50.0).open()
    assert str(caught.value).isprintable()


def test_a_description_that_changes_in_between_is_refused(
    camera: GigeCamera, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetch: Callable[..., bytes] = connection.fetch_genicam
    monkeypatch.setattr(connection, "fetch_genicam", lambda channel: fetch(channel).replace(b"T", b"U", 1))
    assert "two different ways" in failure(table(address))


def test_nothing_stays_behind(camera: GigeCamera, address: str) -> None:
    def held() -> tuple[int, int]:
        return len(list(Path("/proc/self/task").iterdir())), len(list(Path("/proc/self/fd").iterdir()))

    def use_it() -> None:
        with Opened(table(address)) as opened:
            take(opened, 1)
        failure(table(address, features={"Gain": 99.0}))
        wait_for_releases()

    wait_for_releases()
    use_it()  # GLib keeps a thread of its own for ever
    before = held()
    for _ in range(3):
        use_it()
    deadline_s = time.monotonic() + PATIENCE_S
    while any(
        now > then for now, then in zip(held(), before, strict=True)
    ):  # a thread of C is gone a moment after it has ended
        assert time.monotonic() < deadline_s, f"{held()} threads and files, {before} before"
        time.sleep(0.01)

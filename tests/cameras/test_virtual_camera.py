"""The simulated camera as any GigE Vision client sees it: through libaravis, over UDP."""

from __future__ import annotations

import ctypes
import itertools
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cameras.harness import FULL_WELL_RADIANCE, CameraProcess, wait_until
from tests.network_namespace import camera_address
from tests.service.harness import TINY_ROOM

from nearfield_server.capture.aravis.library import BUFFER_SUCCESS, Aravis, load
from nearfield_server.capture.sensor_model import SensorModel
from nearfield_server.scene.room_config import load_room
from nearfield_server.virtual_camera.formats import sampled, sent_format
from nearfield_server.virtual_camera.genicam import EXPOSURE_RANGE_US
from nearfield_server.virtual_camera.scenery import Scenery
from nearfield_server.virtual_camera.sensor import Readout, expected_codes

pytestmark = pytest.mark.cameras
SIDE = 128


class Client:
    """A bare client of libaravis."""

    def __init__(self, address: str) -> None:
        self.aravis: Aravis = load()
        c = self.aravis.c
        self.device = c.arv_gv_device_new(
            c.g_inet_address_new_from_string(b"127.0.0.1"), c.g_inet_address_new_from_string(address.encode())
        )
        self.stream: int | None = None

    def start(self, pixel_format: str, exposure_us: float, frame_rate: float = 50.0) -> None:
        c = self.aravis.c
        c.arv_device_set_string_feature_value(self.device, b"PixelFormat", pixel_format.encode())
        c.arv_device_set_float_feature_value(self.device, b"ExposureTime", exposure_us)
        c.arv_device_set_float_feature_value(self.device, b"AcquisitionFrameRate", frame_rate)
        self.stream = self.aravis.create_stream(self.device)
        size = c.arv_device_get_integer_feature_value(self.device, b"PayloadSize")
        for _ in range(8):
            c.arv_stream_push_buffer(self.stream, c.arv_buffer_new(size, None))
        c.arv_device_execute_command(self.device, b"AcquisitionStart")

    def picture(self) -> tuple[NDArray[np.uint8], int, int]:
        """Payload, frame number and device time of the next whole picture."""
        c = self.aravis.c
        end_s = time.monotonic() + 20.0
        while True:
            buffer = c.arv_stream_timeout_pop_buffer(self.stream, 2_000_000)
            if buffer is None:
                assert time.monotonic() < end_s, "no picture within 20 s"
                # The simulated device looks for stop and start once per picture. On a busy machine a quick pair of both escapes it,
                # and it goes on with memory for pictures of the old format.
                c.arv_device_execute_command(self.device, b"AcquisitionStop")
                time.sleep(0.5)
                c.arv_device_execute_command(self.device, b"AcquisitionStart")
                continue
            size = ctypes.c_size_t()
            address = c.arv_buffer_get_data(buffer, ctypes.byref(size))
            found = None
            if c.arv_buffer_get_status(buffer) == BUFFER_SUCCESS:
                data = np.ctypeslib.as_array((ctypes.c_uint8 * size.value).from_address(address)).copy()
                found = (data, c.arv_buffer_get_frame_id(buffer), c.arv_buffer_get_timestamp(buffer))
            c.arv_stream_push_buffer(self.stream, buffer)
            if found is not None:
                return found

    def close(self) -> None:
        """Stop, and give the simulated device the time of some pictures to notice: it looks for that once per picture."""
        if self.stream is not None:
            self.aravis.c.arv_device_execute_command(self.device, b"AcquisitionStop")
            time.sleep(0.5)
        self.aravis.unref(self.stream)
        self.aravis.unref(self.device)


@pytest.fixture(scope="module")
def camera() -> Iterator[CameraProcess]:
    running = CameraProcess(TINY_ROOM, "0", camera_address(90)).ready()
    yield running
    running.close()


@pytest.fixture
def client(camera: CameraProcess) -> Iterator[Client]:
    connected = Client(camera.address)
    yield connected
    connected.close()
    camera.tell(lights=[1.0, 1.0], picture="live", loss=0.0, clock_ppm=0.0)


def codes_of(data: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Codes of an unpacked 12-bit picture."""
    return data.view("<u2").reshape(SIDE, SIDE).astype(np.float64)


def test_a_picture_is_the_room_as_the_sensor_model_says(camera: CameraProcess, client: Client) -> None:
    client.start("BayerRG12", 200_000.5)
    codes = codes_of(client.picture()[0])
    light = sampled(Scenery(load_room(TINY_ROOM), "0").radiance((1.0, 1.0)), sent_format("BayerRG12"))
    sensor = SensorModel(full_well_radiance=FULL_WELL_RADIANCE)
    mean, deviation = expected_codes(light.astype(np.float64), sensor, Readout(exposure_s=200_000.5e-6))
    # Within seven standard deviations and a rounded code; the converter cuts off what noise takes below 0.
    assert np.all(np.abs(codes - mean) <= 7.0 * deviation + 1.0)
    lit = (mean > 50) & (mean < 4000)
    normal = (codes - mean)[lit] / np.sqrt(deviation[lit] ** 2 + 1 / 12)
    assert np.count_nonzero(lit) > 1000
    assert normal.std() == pytest.approx(1.0, rel=0.1)


def test_packed_codes_arrive_as_they_were_sent(client: Client) -> None:
    client.aravis.c.arv_device_set_string_feature_value(client.device, b"TestPattern", b"GreyDiagonalRamp")
    client.start("BayerRG12p", 1000.0)
    data = client.picture()[0].reshape(-1, 3).astype(np.uint16)
    client.aravis.c.arv_device_set_string_feature_value(client.device, b"TestPattern", b"Off")
    first, second = data[:, 0] | (data[:, 1] & 0xF) << 8, data[:, 1] >> 4 | data[:, 2] << 4
    codes = np.stack([first, second], axis=1).reshape(SIDE, SIDE)
    rows, columns = np.indices((SIDE, SIDE))
    assert np.array_equal(codes, rows + columns)


def test_frames_are_counted_and_timed_and_the_count_wraps(client: Client) -> None:
    client.start("Mono8", 1000.0, frame_rate=200.0)
    numbers, times = zip(*(client.picture()[1:] for _ in range(200)), strict=True)
    steps = {(after - before) % 65535 for before, after in itertools.pairwise(numbers)}
    assert 0 not in numbers
    assert 1 in steps
    assert all(step < 100 for step in steps)
    assert max(numbers) > min(numbers)
    assert np.all(np.diff(times) > 0)


def test_lamps_freeze_lid_and_blinding(camera: CameraProcess, client: Client) -> None:
    client.start("BayerRG12", 100_000.0)
    bright = codes_of(client.picture()[0]).mean()
    camera.tell(lights=[0.0, 1.0])
    wait_until("less light", lambda: codes_of(client.picture()[0]).mean() < 0.9 * bright)
    camera.tell(picture="black")
    wait_until("darkness", lambda: codes_of(client.picture()[0]).mean() < 3.0)
    camera.tell(picture="saturated")
    wait_until("blinding", lambda: bool(np.all(codes_of(client.picture()[0]) == 4095)))
    camera.tell(picture="live", lights=[1.0, 1.0])
    wait_until("light", lambda: abs(codes_of(client.picture()[0]).mean() - bright) < 0.02 * bright)
    camera.tell(picture="frozen")
    client.picture()

    def is_still() -> bool:
        (first, number, _), (second, later, _) = client.picture(), client.picture()
        return bool(np.array_equal(first, second)) and number != later

    wait_until("a frozen picture under new numbers", is_still)


def test_software_trigger_gives_one_picture_each(client: Client) -> None:
    c = client.aravis.c
    c.arv_device_set_string_feature_value(client.device, b"TriggerMode", b"On")
    c.arv_device_set_string_feature_value(client.device, b"TriggerSource", b"Software")
    client.start("Mono8", 1000.0)
    numbers = []
    for _ in range(3):
        c.arv_device_execute_command(client.device, b"TriggerSoftware")
        numbers.append(client.picture()[1])
    assert c.arv_stream_timeout_pop_buffer(client.stream, 200_000) is None
    c.arv_device_set_string_feature_value(client.device, b"TriggerMode", b"Off")
    assert [(number - numbers[0]) % 65535 for number in numbers] == [0, 1, 2]


def test_features_have_their_limits_and_ptp_follows_its_master(client: Client) -> None:
    c = client.aravis.c
    least, greatest = ctypes.c_double(), ctypes.c_double()
    c.arv_device_get_float_feature_bounds(
        client.device, b"ExposureTime", ctypes.byref(least), ctypes.byref(greatest)
    )
    assert (least.value, greatest.value) == EXPOSURE_RANGE_US
    assert c.arv_device_get_string_feature_value(client.device, b"DeviceSerialNumber") == b"TEST-0"
    assert c.arv_device_get_float_feature_value(client.device, b"DeviceTemperature") == 41.5
    client.start("Mono8", 1000.0)
    own_ns = client.picture()[2]
    c.arv_device_set_boolean_feature_value(client.device, b"PtpEnable", True)
    # The time of day is far above that since power-on.
    wait_until("the master's time", lambda: client.picture()[2] > own_ns + 10**17)
    assert c.arv_device_get_string_feature_value(client.device, b"PtpStatus") == b"Slave"
    c.arv_device_set_boolean_feature_value(client.device, b"PtpEnable", False)


def test_an_address_that_cannot_be_had_is_refused_in_words(camera: CameraProcess) -> None:
    command = [sys.executable, "-m", "nearfield_server.virtual_camera", str(TINY_ROOM)]
    for address, words in (
        (camera.address, "another test camera serves there"),
        ("127.250.0.1", "ip address add 127.250.0.1/8 dev lo"),
        ("10.1.2.3", "loopback alone"),
    ):
        options = ["--camera", "0", "--address", address]
        ended = subprocess.run([*command, *options], capture_output=True, text=True, timeout=60)
        assert ended.returncode == 3
        assert words in ended.stderr
        assert "Traceback" not in ended.stderr

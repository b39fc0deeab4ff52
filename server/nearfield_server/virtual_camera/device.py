"""The simulated camera: libaravis's GigE Vision device class, with a room as its picture."""

from __future__ import annotations

import ctypes
import ipaddress
import socket
import struct
import tempfile
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.aravis.library import Aravis, FillPattern, load
from nearfield_server.capture.sensor_model import SensorModel
from nearfield_server.errors import CaptureError, ConfigError
from nearfield_server.virtual_camera.clock import DeviceClock
from nearfield_server.virtual_camera.faults import CameraState, Command
from nearfield_server.virtual_camera.formats import SENT_FORMATS, SentFormat, pack, sampled, sent_format
from nearfield_server.virtual_camera.genicam import (
    FLOAT_FEATURES,
    PATTERN_RAMP,
    PTP_DISABLED,
    PTP_SLAVE,
    Register,
    describe_camera,
)
from nearfield_server.virtual_camera.scenery import Scenery
from nearfield_server.virtual_camera.sensor import Readout, expose

_TRIGGER_POLL_HZ: Final = 250.0
_LAST_FRAME_ID: Final = 65535
_FIRST_FRAME_ID: Final = 65400  # soon wraps: 65535 is followed by 1
_SEEN: Final = b"nearfield-seen"
_BLINDED: Final = np.float32(1e9)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSetup:
    """What a simulated camera is.

    Attributes:
        address: of loopback; GigE Vision has one fixed port, so that every camera needs its own.
        serial: number by which clients find it.
        sensor: `full_well_radiance` is the radiance that fills a pixel in one second at a gain of 1.
        pixel_formats: names of what it offers; the first is set at power-on.
        exposure_delay: frames after a change of exposure or gain that still have the old one.
        temperature_c: of the sensor, degrees Celsius.
    """

    address: str
    serial: str
    sensor: SensorModel
    pixel_formats: tuple[str, ...] = tuple(SENT_FORMATS)
    exposure_delay: int = 0
    temperature_c: float = 41.5


def check_network(address: str) -> None:
    """Make sure that nobody but this machine can reach a simulated camera: it answers every GigE Vision discovery that it hears.

    Raises:
        ConfigError: the address is not of loopback, or the network has another interface than loopback.
    """
    try:
        is_loopback = ipaddress.IPv4Address(address).is_loopback
    except ValueError:
        is_loopback = False
    if not is_loopback:
        raise ConfigError(
            f"address {address!r}: a test camera runs on loopback alone (127.0.0.0/8), never where real cameras are looked for"
        )
    others = [name for _, name in socket.if_nameindex() if name != "lo" and _is_up(name)]
    if others:
        raise ConfigError(
            f"network interface {', '.join(others)} is up: a test camera would answer discovery broadcasts from there. "
            "Start it, and what shall see it, in a network of its own: unshare --map-root-user --net sh -c 'ip link set lo up; ...'"
        )


def _is_up(interface: str) -> bool:
    import fcntl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        answer = fcntl.ioctl(
            any_socket, 0x8913, struct.pack("16sh14x", interface.encode(), 0)
        )  # SIOCGIFFLAGS
    return bool(struct.unpack("16sh14x", answer)[1] & 1)


def _claim_address(address: str) -> socket.socket:
    """Hold an address for one camera: libaravis shares its port, and two cameras would answer by turns.

    Raises:
        CaptureError: another test camera has it.
    """
    # Abstract names of sockets belong to the network namespace, and end with the process.
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0nearfield-test-camera-{address}")
    except OSError as error:
        claim.close()
        raise CaptureError(
            f"{address}: another test camera serves there; each needs an address of its own"
        ) from error
    return claim


class VirtualCamera:
    """A running camera: it serves from a thread of libaravis until the process ends."""

    def __init__(self, setup: CameraSetup, scenery: Scenery) -> None:
        """Switch the camera on.

        Raises:
            ConfigError: the address is not allowed or a pixel format unknown.
            CaptureError: libaravis is missing, or the address is in use or not on any interface.
        """
        check_network(setup.address)
        self._claim = _claim_address(setup.address)
        self.setup, self._scenery = setup, scenery
        self.state = CameraState(lights=scenery.nominal_weights)
        self.frames = 0
        self.failure = ""
        self._skipped = 0
        self._destination = (0, 0)
        self._resume_s = 0.0
        self._clock = DeviceClock(host_ns=time.monotonic_ns())
        self._pending: deque[tuple[float, float]] = deque(maxlen=setup.exposure_delay + 1)
        self._plane_key: tuple[object, ...] = ()
        self._plane = np.zeros((0, 0), np.float32)
        self._codes = np.zeros((0, 0), np.uint16)
        self._payload = np.zeros(0, np.uint8)
        self._aravis: Aravis = load()
        self._pattern = FillPattern(self._fill)
        # Known beforehand: the device class answers from its first moment, and until the registers are set it is another camera.
        size = scenery.radiance(self.state.lights).shape[:2]
        self._device = self._switch_on()
        self._fake = self._aravis.c.arv_gv_fake_camera_get_fake_camera(self._device)
        self._set_registers(*size)
        self._aravis.c.arv_fake_camera_set_trigger_frequency(self._fake, _TRIGGER_POLL_HZ)
        self._aravis.set_fill_pattern(self._fake, self._pattern)

    def _switch_on(self) -> int:
        formats = [sent_format(name) for name in self.setup.pixel_formats]
        xml = describe_camera(formats, max(2**each.bits - 1 for each in formats))
        with tempfile.NamedTemporaryFile("w", suffix=".xml") as file:
            file.write(xml)
            file.flush()
            address, serial = self.setup.address.encode(), self.setup.serial.encode()
            device = self._aravis.c.arv_gv_fake_camera_new_full(address, serial, file.name.encode())
        if device is None or not self._aravis.c.arv_gv_fake_camera_is_running(device):
            self._aravis.unref(device)
            raise CaptureError(
                f"test camera {self.setup.serial}: cannot serve on {self.setup.address}; "
                f"the address must be on an interface: ip address add {self.setup.address}/8 dev lo"
            )
        return device

    def close(self) -> None:
        """Switch the camera off."""
        if self._device:
            self._aravis.unref(self._device)
            self._device = 0
        self._claim.close()

    def apply(self, command: Command) -> None:
        """Change how the camera behaves, between two pictures.

        Raises:
            ConfigError: the running stream has no room for that pixel format.
        """
        before = self.state
        if command.pixel_format is not None:
            wanted = sent_format(command.pixel_format)
            if wanted.wire_bits > self._sent_format(self._read(Register.PIXEL_FORMAT)).wire_bits:
                raise ConfigError(f"pixel format {wanted.name}: larger than the buffer of the running stream")
            self._write(Register.PIXEL_FORMAT, wanted.number)
        for name, value in command.floats.items():
            self._write_float(FLOAT_FEATURES[name], value)
        after = command.apply(before)
        if after.clock_ppm != before.clock_ppm:
            self._clock.run_at(after.clock_ppm, time.monotonic_ns())
        self._clock.jump(after.clock_offset_ns - before.clock_offset_ns)
        self._aravis.set_property(self._device, "gvsp-lost-ratio", after.loss)
        self.state = after

    def tend(self) -> None:
        """Let the stream follow its client; call it some twenty times a second.

        The device class looks up where to send pictures only when a stream begins, and does not notice a client that follows the one before
        within a frame. A stream to nobody is therefore stopped and begun again, and a client that leaves takes its stream with it.
        """
        has_client = self._aravis.c.arv_fake_camera_get_control_channel_privilege(self._fake) != 0
        if not has_client and self._read(Register.ACQUISITION) != 0:
            self._resume_s = 0.0
            self._write(Register.ACQUISITION, 0)
        if self._resume_s and time.monotonic() > self._resume_s:
            self._resume_s = 0.0
            self._write(Register.ACQUISITION, 1)

    def report(self) -> Mapping[str, object]:
        """What the camera has done so far and how it is set."""
        return {
            "frames": self.frames,
            "pixel_format": self._sent_format(self._read(Register.PIXEL_FORMAT)).name,
            "exposure_us": self._read_float(Register.EXPOSURE_US),
            "gain_db": self._read_float(Register.GAIN_DB),
            "is_controlled": self._aravis.c.arv_fake_camera_get_control_channel_privilege(self._fake) != 0,
            "failure": self.failure,
        }

    def _set_registers(self, height: int, width: int) -> None:
        for register, value in (
            (Register.SENSOR_WIDTH, width),
            (Register.SENSOR_HEIGHT, height),
            (Register.WIDTH, width),
            (Register.HEIGHT, height),
            (Register.PIXEL_FORMAT, sent_format(self.setup.pixel_formats[0]).number),
            (Register.PTP_STATUS, PTP_DISABLED),
        ):
            self._write(register, value)
        for address, text in (
            (Register.VENDOR_NAME, "Nearfield"),
            (Register.MODEL_NAME, "TestCamera"),
            (Register.DEVICE_VERSION, "1"),
        ):
            self._write_memory(address, text.encode().ljust(32, b"\0"))
        self._write_float(Register.EXPOSURE_US, 10_000.0)
        self._write_float(Register.GAIN_DB, 0.0)
        self._write_float(Register.BLACK_LEVEL, 0.0)
        self._write_float(Register.TEMPERATURE, self.setup.temperature_c)

    def _fill(self, buffer: int, _data: int | None, _exposure_us: int, _gain: int, number: int) -> None:
        """Draw a picture; called by libaravis in its thread."""
        try:
            self._draw(buffer, self._sent_format(number))
        except Exception as error:  # nothing above could report it
            self.failure = f"{type(error).__name__}: {error}"

    def _follow_client(self, buffer: int) -> None:
        destination = (self._read(Register.STREAM_ADDRESS), self._read(Register.STREAM_PORT))
        if self._aravis.c.g_object_get_data(buffer, _SEEN) is None:
            # A stream has one buffer, made when it begins.
            self._aravis.c.g_object_set_data(buffer, _SEEN, buffer)
            self._destination, self._resume_s = destination, 0.0
        elif self._destination != destination:
            self._write(Register.ACQUISITION, 0)
            # By then the device class has looked at the register: it does so once per frame.
            self._resume_s = time.monotonic() + 0.05 + 1e-6 * self._read(Register.FRAME_PERIOD_US)

    def _draw(self, buffer: int, pixel_format: SentFormat) -> None:
        self._follow_client(buffer)
        state, now_ns = self.state, time.monotonic_ns()
        self._pending.append(
            (self._read_float(Register.EXPOSURE_US) * 1e-6, self._read_float(Register.GAIN_DB))
        )
        exposure_s, gain_db = self._pending[0]
        if state.picture != "frozen" or self._payload.size != self._num_bytes(pixel_format):
            self._expose(state, pixel_format, exposure_s, gain_db)
        target = self._aravis.c.arv_buffer_get_data(buffer, ctypes.byref(ctypes.c_size_t()))
        assert target is not None
        ctypes.memmove(target, self._payload.ctypes.data, self._payload.size)
        self._aravis.c.arv_buffer_set_timestamp(buffer, self._device_time(now_ns) - round(exposure_s * 1e9))
        self._skipped = max(self._skipped, state.skip_frames)
        number = (_FIRST_FRAME_ID - 1 + self.frames + self._skipped) % _LAST_FRAME_ID + 1
        self._aravis.c.arv_buffer_set_frame_id(buffer, number)
        self.frames += 1

    def _expose(
        self, state: CameraState, pixel_format: SentFormat, exposure_s: float, gain_db: float
    ) -> None:
        plane = self._light(state, pixel_format)
        if self._payload.size != self._num_bytes(pixel_format):
            self._payload = np.empty(self._num_bytes(pixel_format), np.uint8)
        if self._codes.shape != plane.shape:
            self._codes = np.empty(plane.shape, np.uint16)
        if self._read(Register.TEST_PATTERN) == PATTERN_RAMP:
            self._codes[...] = _ramp(plane.shape, pixel_format.bits)
        else:
            readout = Readout(
                exposure_s=exposure_s,
                gain=10.0 ** (gain_db / 20.0),
                black_level=self._read_float(Register.BLACK_LEVEL),
                bits=pixel_format.bits,
            )
            expose(plane, self.setup.sensor, readout, self.frames, self._codes)
        pack(self._codes, pixel_format, self._payload)

    def _light(self, state: CameraState, pixel_format: SentFormat) -> NDArray[np.float32]:
        """Radiance on the photodiodes of the region, formed again only when something of it has changed."""
        left, top, width, height = self._region()
        key = (state.lights, state.picture, pixel_format.name, left, top, width, height)
        if key != self._plane_key:
            radiance = self._scenery.radiance(state.lights)[top : top + height, left : left + width]
            if state.picture in ("black", "saturated"):
                radiance = np.full_like(radiance, 0.0 if state.picture == "black" else _BLINDED)
            self._plane, self._plane_key = np.ascontiguousarray(sampled(radiance, pixel_format)), key
        return self._plane

    def _region(self) -> tuple[int, int, int, int]:
        registers = (Register.OFFSET_X, Register.OFFSET_Y, Register.WIDTH, Register.HEIGHT)
        left, top, width, height = (self._read(register) for register in registers)
        return left, top, width, height

    def _num_bytes(self, pixel_format: SentFormat) -> int:
        return pixel_format.num_bytes(self._read(Register.WIDTH), self._read(Register.HEIGHT))

    def _device_time(self, now_ns: int) -> int:
        """The device's clock: its own, or the time of the PTP master (this machine's) while PTP is on."""
        is_on = self._read(Register.PTP_ENABLE) != 0
        self._write(Register.PTP_STATUS, PTP_SLAVE if is_on else PTP_DISABLED)
        if not is_on:
            return max(self._clock.at(now_ns), 0)
        offset_ns = self.state.clock_offset_ns
        self._write_memory(Register.PTP_OFFSET_NS, struct.pack(">q", offset_ns))
        return time.time_ns() + offset_ns

    def _sent_format(self, number: int) -> SentFormat:
        for name in self.setup.pixel_formats:
            if SENT_FORMATS[name].number == number:
                return SENT_FORMATS[name]
        raise CaptureError(
            f"test camera {self.setup.serial}: pixel format {number:#x} is not one that it offers"
        )

    def _read(self, register: int) -> int:
        value = ctypes.c_uint32()
        self._aravis.c.arv_fake_camera_read_register(self._fake, register, ctypes.byref(value))
        return value.value

    def _write(self, register: int, value: int) -> None:
        self._aravis.c.arv_fake_camera_write_register(self._fake, register, value)

    def _read_float(self, register: int) -> float:
        memory = (ctypes.c_char * 8)()
        self._aravis.c.arv_fake_camera_read_memory(self._fake, register, 8, memory)
        value: float = struct.unpack(">d", memory.raw)[0]
        return value

    def _write_float(self, register: int, value: float) -> None:
        self._write_memory(register, struct.pack(">d", value))

    def _write_memory(self, register: int, content: bytes) -> None:
        self._aravis.c.arv_fake_camera_write_memory(self._fake, register, len(content), content)


def _ramp(shape: tuple[int, ...], bits: int) -> NDArray[np.uint16]:
    """Codes that grow by one per pixel to the right and downwards and wrap: every bit of the packing shows."""
    rows, columns = np.arange(shape[0])[:, None], np.arange(shape[1])[None, :]
    ramp = ((rows + columns) % 2**bits).astype(np.uint16)
    return ramp if len(shape) == 2 else np.repeat(ramp[..., None], shape[2], axis=2)


def with_formats(setup: CameraSetup, names: tuple[str, ...]) -> CameraSetup:
    """Return a setup that offers only these formats.

    Raises:
        ConfigError: one of them is unknown.
    """
    return replace(setup, pixel_formats=tuple(sent_format(name).name for name in names))

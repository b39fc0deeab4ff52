"""A USB camera in software (USB Video Class 1.1, bulk transfer), plugged into the kernel's virtual USB port.

The port is vhci-hcd, the host side of USB/IP, and the kernel's own driver uvcvideo drives the camera: exposure in units of 100 us behind an
automatic that has to be switched off first, gain, brightness, white balance; pictures whose level tells the exposure that they were taken
with. Nothing goes over a network: the port is given one end of a socket pair. Sources: the USB Video Class specification 1.1, and the
kernel's documentation of the USB/IP protocol.
"""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

PORT = Path("/sys/devices/platform/vhci_hcd.0")
SIZES = ((160, 120), (80, 60))
JPEG = b"\xff\xd8 stands for a compressed picture \xff\xd9"
_HIGH_SPEED = 3
_STALL = -32
_UNLINKED = -104
_MAX_PAYLOAD = 16384
_HEADER = struct.Struct(">5I28s")
_CONTROL_INTERFACE, _STREAM_INTERFACE = 0, 1
_CAMERA, _PROCESSING, _OUTPUT = 1, 2, 3
_GUID_GREY = bytes.fromhex("5938303000001000800000aa00389b71")
_GET_CUR, _GET_MIN, _GET_MAX, _GET_RES, _GET_LEN, _GET_INFO, _GET_DEF = range(0x81, 0x88)


@dataclass
class UsbControl:
    """A control of the class: length in bytes, limits, value. For the mode of exposure `step` is the set of modes that there are."""

    length: int
    least: int
    greatest: int
    step: int
    default: int
    value: int = -1

    def __post_init__(self) -> None:
        self.value = self.default


def _class_descriptor(kind: int, subtype: int, body: bytes) -> bytes:
    return bytes([len(body) + 3, kind, subtype]) + body


def _frames(subtype: int, sizes: tuple[tuple[int, int], ...]) -> bytes:
    described = b""
    for index, (width, height) in enumerate(sizes, start=1):
        intervals = (333_333, 2_000_000)  # 30 and 5 frames per second, in units of 100 ns
        body = struct.pack(
            "<BBHHIIIIB", index, 0, width, height, 1, 1 << 24, width * height, intervals[0], len(intervals)
        )
        described += _class_descriptor(0x24, subtype, body + struct.pack("<2I", *intervals))
    return described


def _configuration() -> bytes:
    units = (
        _class_descriptor(
            0x24, 0x02, struct.pack("<BHBBHHHB3s", _CAMERA, 0x0201, 0, 0, 0, 0, 0, 3, b"\x0e\0\0")
        )
        + _class_descriptor(
            0x24, 0x05, struct.pack("<BBHB3sBB", _PROCESSING, _CAMERA, 0, 3, b"\x41\x12\0", 0, 0)
        )
        + _class_descriptor(0x24, 0x03, struct.pack("<BHBBB", _OUTPUT, 0x0101, 0, _PROCESSING, 0))
    )
    header = struct.pack("<HHIBB", 0x0110, 13 + len(units), 48_000_000, 1, _STREAM_INTERFACE)
    control = struct.pack("9B", 9, 4, _CONTROL_INTERFACE, 0, 0, 0x0E, 1, 0, 2)
    control += _class_descriptor(0x24, 0x01, header) + units
    grey, jpeg = _frames(0x05, SIZES), _frames(0x07, SIZES[:1])
    formats = (
        _class_descriptor(
            0x24, 0x04, struct.pack("<BB16sBBBBBB", 1, len(SIZES), _GUID_GREY, 8, 1, 0, 0, 0, 0)
        )
        + grey
        + _class_descriptor(0x24, 0x06, struct.pack("8B", 2, 1, 1, 1, 0, 0, 0, 0))
        + jpeg
    )
    inputs = struct.pack("<BHBBBBBBB2s", 2, 15 + len(formats), 0x81, 0, _OUTPUT, 0, 0, 0, 1, b"\0\0")
    stream = struct.pack("9B", 9, 4, _STREAM_INTERFACE, 0, 1, 0x0E, 2, 0, 0)
    stream += _class_descriptor(0x24, 0x01, inputs) + formats + struct.pack("<BBBBHB", 7, 5, 0x81, 2, 512, 0)
    body = struct.pack("8B", 8, 0x0B, _CONTROL_INTERFACE, 2, 0x0E, 3, 0, 2) + control + stream
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 2, 1, 0, 0x80, 250) + body


class UsbCamera:
    """The camera; `plug` and `unplug` may be called again and again. It serves its port in a thread.

    Attributes:
        serial: serial number.
        exposure: control in units of 100 us. mode: of exposure, 1 manual, 8 aperture priority. gain: control.
        delay: pictures that still have the old exposure after a change.
    """

    def __init__(self, serial: str = "NF-1234", delay: int = 2) -> None:
        self.serial, self.delay = serial, delay
        self._socket: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._reset()

    def _reset(self) -> None:
        """Power on: everything is at its default."""
        self.mode = UsbControl(1, 1, 8, 1 | 8, 8)
        self.exposure = UsbControl(4, 1, 200, 1, 20)
        self.gain = UsbControl(2, 0, 100, 1, 60)
        self._controls = {
            (_CAMERA, 0x02): self.mode,
            (_CAMERA, 0x03): UsbControl(1, 0, 1, 1, 1),
            (_CAMERA, 0x04): self.exposure,
            (_PROCESSING, 0x02): UsbControl(2, 0, 255, 1, 128),
            (_PROCESSING, 0x04): self.gain,
            (_PROCESSING, 0x0A): UsbControl(2, 2800, 6500, 10, 4600),
            (_PROCESSING, 0x0B): UsbControl(1, 0, 1, 1, 1),
        }
        self._probe = bytearray(34)
        self._choose(1, 1, 333_333)
        self._reads: deque[tuple[int, int]] = deque()
        self._payloads: deque[bytes] = deque()
        self._pipeline: deque[int] = deque()
        self._frame_bit = 0
        self._next_s = 0.0
        self._damaged = 0
        self._taken = 0

    def plug(self) -> None:
        """Plug the camera in."""
        self._reset()
        ours, theirs = socket.socketpair()
        self._socket = ours
        self._thread = threading.Thread(target=self._serve, args=(ours,), daemon=True)
        self._thread.start()
        with theirs:
            (PORT / "attach").write_text(f"0 {theirs.fileno()} {0x10002} {_HIGH_SPEED}", encoding="ascii")

    def unplug(self) -> None:
        """Pull the plug."""
        if self._socket is not None and self._thread is not None:
            self._socket.shutdown(socket.SHUT_RDWR)
            self._thread.join()
            self._socket.close()
            self._socket = None

    def damage_next(self) -> None:
        """Say of the next picture that it is damaged."""
        self._damaged += 1

    # -- the port -----------------------------------------------------------------------------------------------------------

    def _serve(self, port: socket.socket) -> None:
        try:
            while True:
                waits_s = max(0.0, self._next_s - time.monotonic()) if self._reads else None
                if select.select([port], [], [], waits_s)[0]:
                    self._answer(port)
                elif self._reads:
                    self._deliver(port)
        except (ConnectionError, EOFError):
            return

    @staticmethod
    def _receive(port: socket.socket, count: int) -> bytes:
        data = b""
        while len(data) < count:
            part = port.recv(count - len(data))
            if not part:
                raise EOFError
            data += part
        return data

    @staticmethod
    def _reply(
        port: socket.socket, sequence: int, status: int, data: bytes = b"", length: int | None = None
    ) -> None:
        body = struct.pack(">5i8x", status, len(data) if length is None else length, 0, 0, 0)
        port.sendall(_HEADER.pack(3, sequence, 0, 0, 0, body) + data)

    def _answer(self, port: socket.socket) -> None:
        command, sequence, _device, is_in, endpoint, body = _HEADER.unpack(self._receive(port, _HEADER.size))
        if command == 2:  # take a request back
            (wanted,) = struct.unpack_from(">I", body)
            waiting = [read for read in self._reads if read[0] == wanted]
            for read in waiting:
                self._reads.remove(read)
            self._payloads.clear()
            status = struct.pack(">i24x", _UNLINKED if waiting else 0)
            port.sendall(_HEADER.pack(4, sequence, 0, 0, 0, status))
            return
        _flags, length = struct.unpack_from(">Ii", body)
        if endpoint == 1:
            if not self._reads:
                self._next_s = max(self._next_s, time.monotonic())
            self._reads.append((sequence, length))
            return
        setup = body[20:28]
        sent = b"" if is_in else self._receive(port, length)
        found = self._control(setup, sent)
        if found is None:
            self._reply(port, sequence, _STALL)
        elif is_in:
            self._reply(port, sequence, 0, found[: min(length, struct.unpack_from("<H", setup, 6)[0])])
        else:
            self._reply(port, sequence, 0, length=len(sent))

    # -- control transfers --------------------------------------------------------------------------------------------------

    def _control(self, setup: bytes, sent: bytes) -> bytes | None:
        """Answer to a request; None = refused."""
        kind, request, value, index = struct.unpack_from("<BBHH", setup)
        if kind & 0x60 == 0:
            return self._standard(request, value)
        selector, unit, interface = value >> 8, index >> 8, index & 0xFF
        if interface == _STREAM_INTERFACE and selector in (1, 2):
            return self._negotiate(request, sent)
        control = self._controls.get((unit, selector))
        if control is None or interface != _CONTROL_INTERFACE:
            return None
        if request == 0x01:
            wish = int.from_bytes(sent, "little")
            if selector == 0x04 and unit == _CAMERA and self.mode.value != 1:
                return None  # the automatic has the exposure
            control.value = min(max(wish, control.least), control.greatest)
            return b""
        answers = {
            _GET_CUR: control.value,
            _GET_MIN: control.least,
            _GET_MAX: control.greatest,
            _GET_RES: control.step,
            _GET_DEF: control.default,
        }
        if request == _GET_LEN:
            return control.length.to_bytes(2, "little")
        if request == _GET_INFO:
            return b"\x03"
        return None if request not in answers else answers[request].to_bytes(control.length, "little")

    def _standard(self, request: int, value: int) -> bytes | None:
        if request != 6:  # descriptors; all other standard requests are granted
            return b"\0\0"
        kind, number = value >> 8, value & 0xFF
        if kind == 1:
            return struct.pack(
                "<BBHBBBBHHHBBBB", 18, 1, 0x0200, 0xEF, 2, 1, 64, 0x1209, 1, 0x0100, 1, 2, 3, 1
            )
        if kind == 2:
            return _configuration()
        if kind == 3:
            if number == 0:
                return b"\x04\x03\x09\x04"
            words = {1: "Nearfield", 2: "Software camera", 3: self.serial}.get(number)
            if words is not None:
                return bytes([2 + 2 * len(words), 3]) + words.encode("utf-16-le")
        return None

    def _choose(self, kind: int, size: int, interval: int) -> None:
        width, height = SIZES[min(max(size, 1), len(SIZES)) - 1]
        struct.pack_into(
            "<HBBI", self._probe, 0, 1, min(max(kind, 1), 2), min(max(size, 1), len(SIZES)), interval
        )
        struct.pack_into("<III", self._probe, 18, width * height, _MAX_PAYLOAD, 48_000_000)

    def _negotiate(self, request: int, sent: bytes) -> bytes | None:
        if request == 0x01:
            _hint, kind, size, interval = struct.unpack_from("<HBBI", sent)
            self._choose(kind, size, 333_333 if interval < 1_000_000 else 2_000_000)
            return b""
        if request == _GET_LEN:
            return (34).to_bytes(2, "little")
        return b"\x03" if request == _GET_INFO else bytes(self._probe)

    # -- pictures -----------------------------------------------------------------------------------------------------------

    def _expose(self) -> None:
        """Take a picture: its level is the exposure that was set `delay` pictures ago, or 250 with the automatic on."""
        _hint, kind, size, interval = struct.unpack_from("<HBBI", self._probe)
        self._next_s = time.monotonic() + interval * 1e-7
        self._pipeline.append(self.exposure.value if self.mode.value == 1 else 250)
        level = self._pipeline.popleft() if len(self._pipeline) > self.delay else self._pipeline[0]
        width, height = SIZES[size - 1]
        # The first bytes differ from picture to picture, as noise would make them.
        data = JPEG if kind == 2 else struct.pack("<I", self._taken) + bytes([level]) * (width * height - 4)
        self._taken += 1
        flags = 0x80 | self._frame_bit
        if self._damaged:
            self._damaged -= 1
            flags |= 0x40
        step = _MAX_PAYLOAD - 2
        for begin in range(0, len(data), step):
            end = 0x02 if begin + step >= len(data) else 0
            self._payloads.append(bytes([2, flags | end]) + data[begin : begin + step])
        self._frame_bit ^= 1

    def _deliver(self, port: socket.socket) -> None:
        if not self._payloads:
            self._expose()
        while self._payloads and self._reads:
            sequence, length = self._reads.popleft()
            self._reply(port, sequence, 0, self._payloads.popleft()[:length])
        if self._payloads:
            self._next_s = 0.0

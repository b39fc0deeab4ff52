"""A GigE Vision camera in a thread, written after the standard, packet by packet: it does what libaravis's simulated camera cannot.

Labels in pictures (chunk data), a sequencer, a refusal of strangers, long picture numbers, packets left out at will, harmful descriptions.
"""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Self

PORT = 3956
XML_ADDRESS = 0x100000
MONO8, MONO16, BAYER_RG12P = 0x01080001, 0x01100007, 0x010C0059
FORMATS = {"Mono8": MONO8, "Mono16": MONO16, "BayerRG12p": BAYER_RG12P}
CHUNK_EXPOSURE, CHUNK_GAIN = 0x1001, 0x1002

CONTROL, HEARTBEAT, TICKS_HIGH, TICKS_LOW = 0xA00, 0x938, 0x93C, 0x940
STREAM_PORT, PACKET_SIZE, STREAM_ADDRESS = 0xD00, 0xD04, 0xD18
REGISTERS = {
    name: 0x20000 + 8 * index
    for index, name in enumerate(
        (
            *("Width", "Height", "OffsetX", "OffsetY", "PixelFormat", "PayloadSize"),
            *("BinningHorizontal", "BinningVertical", "AcquisitionStart", "AcquisitionStop"),
            *("ExposureTime", "Gain", "BlackLevel", "AcquisitionFrameRate", "DeviceTemperature"),
            *("ExposureAuto", "TriggerMode", "TriggerSource", "TriggerSoftware"),
            *("ChunkModeActive", "ChunkSelector", "ChunkEnable"),
            *("SequencerMode", "SequencerConfigurationMode", "SequencerSetSelector", "SequencerSetNext"),
            *("SequencerSetSave", "SequencerSetStart", "PtpEnable", "PtpStatus", "PtpOffsetFromMaster"),
            *("ReverseX", "UserSetLoad", "Lines"),
        )
    )
}
FLOATS = {"ExposureTime", "Gain", "BlackLevel", "AcquisitionFrameRate", "DeviceTemperature"}


def _register(name: str, tag: str, extra: str = "", access: str = "RW") -> str:
    length = 8 if tag == "FloatReg" else 4
    return (
        f'<{tag} Name="{name}"><Address>{REGISTERS[name.removesuffix("Reg")]:#x}</Address><Length>{length}</Length>'
        f"<AccessMode>{access}</AccessMode><pPort>Device</pPort>{extra}<Endianess>BigEndian</Endianess></{tag}>"
    )


def integer(name: str, least: int, greatest: int, step: int = 1, access: str = "RW") -> str:
    return (
        f'<Integer Name="{name}"><pValue>{name}Reg</pValue><Min>{least}</Min><Max>{greatest}</Max><Inc>{step}</Inc></Integer>'
        + _register(f"{name}Reg", "IntReg", "<Sign>Unsigned</Sign>", access)
    )


def floating(name: str, least: float, greatest: float, unit: str = "", access: str = "RW") -> str:
    return (
        f'<Float Name="{name}"><pValue>{name}Reg</pValue><Min>{least}</Min><Max>{greatest}</Max><Unit>{unit}</Unit></Float>'
        + _register(f"{name}Reg", "FloatReg", "", access)
    )


def enumeration(name: str, entries: dict[str, int]) -> str:
    listed = "".join(
        f'<EnumEntry Name="{key}"><Value>{value}</Value></EnumEntry>' for key, value in entries.items()
    )
    return f'<Enumeration Name="{name}">{listed}<pValue>{name}Reg</pValue></Enumeration>' + _register(
        f"{name}Reg", "IntReg", "<Sign>Unsigned</Sign>"
    )


def command(name: str) -> str:
    return (
        f'<Command Name="{name}"><pValue>{name}Reg</pValue><CommandValue>1</CommandValue></Command>'
        + _register(f"{name}Reg", "IntReg", "<Sign>Unsigned</Sign>")
    )


def boolean(name: str) -> str:
    return f'<Boolean Name="{name}"><pValue>{name}Reg</pValue></Boolean>' + _register(
        f"{name}Reg", "IntReg", "<Sign>Unsigned</Sign>"
    )


def describe(*further: str) -> bytes:
    """The camera's description; later nodes with a name that was there replace the earlier ones."""
    off_on = {"Off": 0, "On": 1}
    nodes = [
        integer("Width", 8, 256, 4),
        integer("Height", 8, 256, 4),
        integer("OffsetX", 0, 128, 4),
        integer("OffsetY", 0, 128, 4),
        integer("BinningHorizontal", 1, 2),
        integer("BinningVertical", 1, 2),
        integer("PayloadSize", 0, 1 << 24, access="RO"),
        enumeration("PixelFormat", FORMATS),
        command("AcquisitionStart"),
        command("AcquisitionStop"),
        floating("ExposureTime", 10, 1e6, "us"),
        floating("Gain", 0, 40, "dB"),
        floating("BlackLevel", 0, 100),
        floating("AcquisitionFrameRate", 1, 200, "Hz"),
        floating("DeviceTemperature", -50, 150, "C", "RO"),
        enumeration("ExposureAuto", {"Off": 0, "Continuous": 2}),
        enumeration("TriggerMode", off_on),
        enumeration("TriggerSource", {"Software": 0, "Line1": 1}),
        command("TriggerSoftware"),
        boolean("ChunkModeActive"),
        enumeration("ChunkSelector", {"ExposureTime": 0, "Gain": 1}),
        boolean("ChunkEnable"),
        enumeration("SequencerMode", off_on),
        enumeration("SequencerConfigurationMode", off_on),
        integer("SequencerSetSelector", 0, 3),
        integer("SequencerSetNext", 0, 3),
        command("SequencerSetSave"),
        integer("SequencerSetStart", 0, 3),
        boolean("PtpEnable"),
        enumeration("PtpStatus", {"Listening": 4, "Slave": 9}),
        integer("PtpOffsetFromMaster", 0, 1 << 31),
        boolean("ReverseX"),
        command("UserSetLoad"),
        integer("Lines", 0, 1000, access="RO"),
        *(
            f'<Port Name="{name}Port"><ChunkID>{chunk:x}</ChunkID></Port>'
            f'<FloatReg Name="{name}"><Address>0</Address><Length>8</Length><AccessMode>RO</AccessMode>'
            f"<pPort>{name}Port</pPort><Endianess>BigEndian</Endianess></FloatReg>"
            for name, chunk in (("ChunkExposureTime", CHUNK_EXPOSURE), ("ChunkGain", CHUNK_GAIN))
        ),
        '<Port Name="Device"></Port>',
        *further,
    ]
    return (
        '<?xml version="1.0" encoding="utf-8"?><RegisterDescription ModelName="T" VendorName="Test" StandardNameSpace="None" '
        'SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
        f'xmlns="http://www.genicam.org/GenApi/Version_1_1">{"".join(nodes)}</RegisterDescription>'
    ).encode()


class GigeCamera:
    """A camera on an address of loopback, until `close`.

    Args:
        address: IPv4 address, present on an interface.
        xml: its description. url: where it says that lies; None = in its memory.
        with_long_ids: number pictures with 64 bits.
        first_id: number of the first picture.

    Attributes:
        values: of the features, by name.
        is_lost: (picture, packet) -> whether this packet is not sent; packet 0 is the leader.
        sent_format, sent_size, payload_type: what leaders say, where it shall be something else than what was set.
        writes: names of the features that were written, in order.
        broadcasts: packets heard that were addressed to everybody.
    """

    def __init__(
        self,
        address: str,
        xml: bytes | None = None,
        url: bytes | None = None,
        with_long_ids: bool = False,
        first_id: int = 1,
    ) -> None:
        self.address, self.with_long_ids, self.next_id = address, with_long_ids, first_id
        self.is_lost: Callable[[int, int], bool] = lambda picture, packet: False
        self.sent_format: int | None = None
        self.sent_size: tuple[int, int] | None = None
        self.payload_type = 1
        self.writes: list[str] = []
        self.broadcasts = 0
        self.controller: tuple[str, int] | None = None
        self._heard_s = 0.0
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self.is_answering = True
        self.forget()
        xml = describe() if xml is None else xml
        url = b"Local:test.xml;%x;%x" % (XML_ADDRESS, len(xml)) if url is None else url
        self._memory = {0x200: url.ljust(512, b"\0"), 0x400: bytes(512), XML_ADDRESS: xml + bytes(512)}
        self._control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._control.bind((address, PORT))
        self._broadcasts = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._broadcasts.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._broadcasts.bind(("255.255.255.255", PORT))
        self._stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._stream.bind((address, 0))
        self._threads = [threading.Thread(target=work) for work in (self._serve, self._send)]
        for thread in self._threads:
            thread.start()

    def forget(self) -> None:
        """As after power was lost: settings of the factory, nobody in control."""
        with self._lock:
            self.controller = None
            self.is_streaming, self.triggers = False, 0
            self.registers = {
                **{0x4: 0x80000001, 0x900: 1, 0x904: 1, 0x934: 0, CONTROL: 0, HEARTBEAT: 3000},
                **{
                    TICKS_HIGH: 0,
                    TICKS_LOW: 1_000_000_000,
                    STREAM_PORT: 0,
                    PACKET_SIZE: 1400,
                    STREAM_ADDRESS: 0,
                },
            }
            self.values: dict[str, float] = dict.fromkeys(REGISTERS, 0)
            self.values |= {"Width": 256, "Height": 256, "PixelFormat": MONO8, "ExposureTime": 1000.0}
            self.values |= {"BinningHorizontal": 1, "BinningVertical": 1, "AcquisitionFrameRate": 50.0}
            self.values |= {
                "DeviceTemperature": 41.5,
                "ExposureAuto": 2,
                "PtpStatus": 9,
                "PtpOffsetFromMaster": 250,
            }
            self.enabled_chunks: dict[int, bool] = {}
            self.sets: dict[int, tuple[float, float, int]] = {}
            self.current_set: int | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Switch it off."""
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._control.close()
        self._broadcasts.close()
        self._stream.close()

    # Control (GigE Vision 2.0, chapters 14 to 18)

    def _serve(self) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select([self._control, self._broadcasts], [], [], 0.02)
            for channel in ready:
                packet, sender = channel.recvfrom(2048)
                self.broadcasts += channel is self._broadcasts
                if self.is_answering and len(packet) >= 8:
                    self._reply(packet, sender)

    def _reply(self, packet: bytes, sender: tuple[str, int]) -> None:
        _, _, kind, length, request_id = struct.unpack_from(">BBHHH", packet)
        with self._lock:
            status, payload = self._answer(kind, packet[8 : 8 + length], sender)
        reply = struct.pack(">HHHH", status, kind + 1, len(payload), request_id) + payload
        self._control.sendto(reply, sender)

    def _answer(self, kind: int, payload: bytes, sender: tuple[str, int]) -> tuple[int, bytes]:
        if self.controller == sender:
            self._heard_s = time.monotonic()
        if kind == 0x02:
            return 0, self._read_block(0, 248)
        if kind == 0x80:
            return 0, struct.pack(">I", self._read(struct.unpack(">I", payload)[0]))
        if kind == 0x84:
            start, _, count = struct.unpack(">IHH", payload)
            return 0, payload[:4] + self._read_block(start, count)
        if kind in (0x82, 0x86):
            address = struct.unpack_from(">I", payload)[0]
            if not self._may_write(address, sender):
                return 0x8006, b""
            if kind == 0x82:
                self._write(address, struct.unpack_from(">I", payload, 4)[0])
            else:
                self._write_block(address, payload[4:])
            return 0, bytes([0, 0, 0, 1])
        return 0x8001, b""

    def _may_write(self, address: int, sender: tuple[str, int]) -> bool:
        if self.controller is not None and self.controller != sender:
            if time.monotonic() - self._heard_s < self.registers[HEARTBEAT] / 1000:
                return False
            self.controller = None
        if address == CONTROL:
            self.controller, self._heard_s = sender, time.monotonic()
        return self.controller == sender

    def _name(self, address: int) -> str | None:
        return next((name for name, place in REGISTERS.items() if place == address), None)

    def _read(self, address: int) -> int:
        name = self._name(address)
        if name == "PayloadSize":
            return len(self._payload(1000.0, 0.0, 0))
        if name == "ChunkEnable":
            return int(self.enabled_chunks.get(int(self.values["ChunkSelector"]), False))
        if name == "SequencerSetNext":
            return int(self.values[name])
        if name is not None:
            return int(self.values[name]) & 0xFFFFFFFF
        return self.registers.get(address, 0)

    def _read_block(self, start: int, count: int) -> bytes:
        name = self._name(start)
        if name in FLOATS:
            return struct.pack(">d", self.values[name])[:count].ljust(count, b"\0")
        if name is not None or start in self.registers:
            return struct.pack(">I", self._read(start)).rjust(count, b"\0")
        if start < 0x200:
            names = {
                0x48: b"Test Cameras",
                0x68: b"T100",
                0x88: b"1.0",
                0xD8: self.address.encode(),
                0xE8: b"bench",
            }
            block = bytearray(0x200)
            block[0x24:0x28] = socket.inet_aton(self.address)
            for place, text in names.items():
                block[place : place + len(text)] = text
            return bytes(block[start : start + count])
        for place, content in self._memory.items():
            if place <= start < place + len(content):
                return content[start - place : start - place + count].ljust(count, b"\0")
        return bytes(count)

    def _write_block(self, start: int, data: bytes) -> None:
        name = self._name(start)
        if name in FLOATS:
            self.writes.append(name)
            self.values[name] = struct.unpack(">d", data[:8])[0]
        else:
            self._write(start, int.from_bytes(data[-4:], "big"))

    def _write(self, address: int, value: int) -> None:
        name = self._name(address)
        if address == CONTROL and value == 0:
            self.controller, self.is_streaming = None, False
        if name is None:
            self.registers[address] = value
            return
        self.writes.append(name)
        match name:
            case "AcquisitionStart":
                self.current_set = (
                    int(self.values["SequencerSetStart"]) if self.values["SequencerMode"] else None
                )
                self.is_streaming = True
            case "AcquisitionStop":
                self.is_streaming = False
            case "TriggerSoftware":
                self.triggers += 1
            case "ChunkEnable":
                self.enabled_chunks[int(self.values["ChunkSelector"])] = bool(value)
            case "SequencerSetSave":
                self.sets[int(self.values["SequencerSetSelector"])] = (
                    self.values["ExposureTime"],
                    self.values["Gain"],
                    int(self.values["SequencerSetNext"]),
                )
            case _:
                self.values[name] = value

    # Pictures (GigE Vision 2.0, chapters 23 to 25)

    def picture_bytes(self, index: int) -> bytes:
        """Payload of picture `index` without labels: bytes that count up from its number."""
        bits = int(self.values["PixelFormat"]) >> 16 & 0xFF
        count = int(self.values["Width"]) * int(self.values["Height"]) * bits // 8
        return bytes((index + place) & 0xFF for place in range(256)) * (count // 256 + 1)

    def _payload(self, exposure_us: float, gain_db: float, index: int) -> bytes:
        bits = int(self.values["PixelFormat"]) >> 16 & 0xFF
        count = int(self.values["Width"]) * int(self.values["Height"]) * bits // 8
        payload = self.picture_bytes(index)[:count]
        if self.values["ChunkModeActive"]:
            payload += struct.pack(">II", 1, len(payload))
            for chunk, selector, value in ((CHUNK_EXPOSURE, 0, exposure_us), (CHUNK_GAIN, 1, gain_db)):
                if self.enabled_chunks.get(selector):
                    payload += struct.pack(">dII", value, chunk, 8)
        return payload

    def _send(self) -> None:
        index, due_s = 0, time.monotonic()
        while not self._stop.is_set():
            due_s = max(due_s + 1.0 / max(self.values["AcquisitionFrameRate"], 1.0), time.monotonic() - 0.1)
            self._stop.wait(max(0.0, due_s - time.monotonic()))
            with self._lock:
                if not self.is_streaming or not self.is_answering:
                    continue
                if self.values["TriggerMode"]:
                    if not self.triggers:
                        continue
                    self.triggers -= 1
                exposure_us, gain_db = self.values["ExposureTime"], self.values["Gain"]
                if self.current_set is not None:
                    exposure_us, gain_db, self.current_set = self.sets[self.current_set]
                self._send_picture(index, self._payload(exposure_us, gain_db, index))
                index += 1

    def _send_picture(self, index: int, payload: bytes) -> None:
        number, self.next_id = self.next_id, self.next_id + 1
        if not self.with_long_ids and self.next_id > 0xFFFF:
            self.next_id = 1
        overhead = 20 + 8 + (20 if self.with_long_ids else 8)
        step = self.registers[PACKET_SIZE] - overhead
        width, height = self.sent_size or (int(self.values["Width"]), int(self.values["Height"]))
        payload_type = self.payload_type | (0x4000 if self.values["ChunkModeActive"] else 0)
        code = self.sent_format or int(self.values["PixelFormat"])
        nanoseconds = time.monotonic_ns()
        leader = struct.pack(">HHQIIIIIHH", 0, payload_type, nanoseconds, code, width, height, 0, 0, 0, 0)
        trailer = struct.pack(">HHI", 0, payload_type, height)
        pieces = [
            (1, leader),
            *((3, payload[place : place + step]) for place in range(0, len(payload), step)),
        ]
        for packet_id, (content, data) in enumerate([*pieces, (2, trailer)]):
            if not self.is_lost(index, packet_id):
                head = (
                    struct.pack(">HHIQI", 0, 0, 0x80000000 | content << 24, number, packet_id)
                    if self.with_long_ids
                    else struct.pack(">HHI", 0, number, content << 24 | packet_id)
                )
                target = socket.inet_ntoa(struct.pack(">I", self.registers[STREAM_ADDRESS]))
                self._stream.sendto(head + data, (target, self.registers[STREAM_PORT]))

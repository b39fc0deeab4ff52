"""Pictures received straight into memory of ours, from where they are lent out without a copy."""

from __future__ import annotations

import ctypes
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.aravis.library import (
    BUFFER_STATUS,
    BUFFER_SUCCESS,
    PACKET_SIZE_NEVER,
    PACKET_SIZE_ON_FAILURE_ONCE,
    Aravis,
)
from nearfield_server.capture.aravis.receive_buffer import (
    buffer_warning,
    can_open_packet_sockets,
    enlarge_receive_buffer,
    wanted_bytes,
)
from nearfield_server.errors import CaptureError

_ALIGNMENT = 64  # bytes; a cache line
_IMAGE, _EXTENDED_CHUNK = 1, 5
_OLDEST_LEADER_NS = 10_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceivedPicture:
    """A whole picture in one of the buffers.

    Attributes:
        buffer: the ArvBuffer, lent until `Stream.give_back`.
        data: (received bytes,) uint8, view of the buffer's memory.
        has_image: it is an image (not chunks alone, as of GigE Vision 1, or several parts).
        format_code: pixel format, as GenICam numbers them; 0 without image.
        width: pixels. height: pixels. padding: bytes after each row.
        device_id: its number as the device counts. device_ns: time as the device tells it.
        arrival_ns: CLOCK_MONOTONIC when the whole picture had arrived.
    """

    buffer: int
    data: NDArray[np.uint8]
    has_image: bool
    format_code: int
    width: int
    height: int
    padding: int
    device_id: int
    device_ns: int
    arrival_ns: int


class Stream:
    """The stream of an opened device.

    Args:
        aravis: the library.
        device: the ArvDevice.
        is_gige: it comes over the network.
        payload_bytes: size of each buffer.
        num_buffers: how many.

    Attributes:
        handle: the ArvStream; its reference is given back by whoever owns the stream.
        memory: all buffers; must stay alive until the ArvStream is gone.
        warning: words for the user if the kernel's receive buffer is too small.
        receive_buffer_bytes: what the kernel granted; 0 where none is used.
        broken: pictures that came with holes, by kind of damage.

    Raises:
        AravisError: the device refuses.
    """

    def __init__(
        self, aravis: Aravis, device: int, is_gige: bool, payload_bytes: int, num_buffers: int
    ) -> None:
        self._aravis, self._c, self._device, self._is_gige = aravis, aravis.c, device, is_gige
        stride = -(-payload_bytes // _ALIGNMENT) * _ALIGNMENT
        raw = np.zeros(stride * num_buffers + _ALIGNMENT, np.uint8)
        start = -raw.ctypes.data % _ALIGNMENT
        self.memory = raw[start : start + stride * num_buffers].reshape(num_buffers, stride)[
            :, :payload_bytes
        ]
        self.handle = aravis.create_stream(device)
        self.warning, self.receive_buffer_bytes = "", 0
        self.broken: dict[str, int] = {}
        self._lent: dict[int, int] = {}
        self._rows = {row.ctypes.data: row for row in self.memory}
        self._shortest_transfer_ns = _OLDEST_LEADER_NS
        if is_gige and not can_open_packet_sockets():
            port = self._c.arv_gv_stream_get_port(self.handle)
            self.receive_buffer_bytes = enlarge_receive_buffer(port, wanted_bytes(payload_bytes))
            self.warning = buffer_warning(payload_bytes, self.receive_buffer_bytes)
        for address in self._rows:
            self._c.arv_stream_push_buffer(self.handle, self._c.arv_buffer_new(payload_bytes, address))

    def start(self) -> None:
        """Let the device send."""
        self._aravis.start_acquisition(self._device, self.handle)

    def stop(self) -> None:
        """Let the device stop, and forget pictures that wait.

        Raises:
            AravisError: the device does not answer.
        """
        self._aravis.stop_acquisition(self._device, self.handle)
        while (buffer := self._c.arv_stream_try_pop_buffer(self.handle)) is not None:
            self._c.arv_stream_push_buffer(self.handle, buffer)

    def take(self, timeout_s: float) -> tuple[bool, ReceivedPicture | None]:
        """Wait for the oldest picture.

        Returns:
            Whether anything came, and the picture if it is whole. A broken one is counted and its buffer used again.
        """
        buffer = self._c.arv_stream_try_pop_buffer(self.handle)
        has_waited = buffer is None
        if buffer is None and timeout_s > 0:
            buffer = self._c.arv_stream_timeout_pop_buffer(self.handle, round(timeout_s * 1e6))
        if buffer is None:
            return False, None
        now_ns, clock_ns = time.monotonic_ns(), time.time_ns()
        status = self._c.arv_buffer_get_status(buffer)
        size = ctypes.c_size_t(0)
        address = self._c.arv_buffer_get_data(buffer, ctypes.byref(size))
        row = self._rows.get(address or 0)
        if status != BUFFER_SUCCESS or row is None or not 0 < size.value <= row.size:
            kind = BUFFER_STATUS.get(status, "unknown") if status != BUFFER_SUCCESS else "wrong size"
            self.broken[kind] = self.broken.get(kind, 0) + 1
            self._c.arv_stream_push_buffer(self.handle, buffer)
            return True, None
        has_image = self._c.arv_buffer_get_payload_type(buffer) in (_IMAGE, _EXTENDED_CHUNK)
        right, below = ctypes.c_int(0), ctypes.c_int(0)
        if has_image:
            self._c.arv_buffer_get_image_padding(buffer, ctypes.byref(right), ctypes.byref(below))
        age_ns = clock_ns - self._c.arv_buffer_get_system_timestamp(buffer)
        self._lent[row.ctypes.data] = buffer
        return True, ReceivedPicture(
            buffer=buffer,
            data=row[: size.value],
            has_image=has_image,
            format_code=self._c.arv_buffer_get_image_pixel_format(buffer) if has_image else 0,
            width=self._c.arv_buffer_get_image_width(buffer) if has_image else 0,
            height=self._c.arv_buffer_get_image_height(buffer) if has_image else 0,
            padding=right.value,
            device_id=self._c.arv_buffer_get_frame_id(buffer),
            device_ns=self._c.arv_buffer_get_timestamp(buffer),
            arrival_ns=self._arrival(now_ns, age_ns, has_waited),
        )

    def give_back(self, data: NDArray[np.uint8]) -> None:
        """Let the memory of a picture be used again; what was not lent is ignored."""
        buffer = self._lent.pop(data.ctypes.data, None)
        if buffer is not None:
            self._c.arv_stream_push_buffer(self.handle, buffer)

    def take_back_all(self) -> None:
        """Give every lent buffer back: the stream is about to end, and with it its buffers (not the memory that views show)."""
        for buffer in self._lent.values():
            self._c.arv_stream_push_buffer(self.handle, buffer)
        self._lent.clear()

    def packets(self) -> dict[str, int]:
        """Packets asked for again, missing, and without a buffer because pictures were not given back in time."""
        completed, failures, underruns = (ctypes.c_uint64(0) for _ in range(3))
        self._c.arv_stream_get_statistics(
            self.handle, ctypes.byref(completed), ctypes.byref(failures), ctypes.byref(underruns)
        )
        found = {"packets_without_buffer": underruns.value}
        if self._is_gige:
            resent, missing = ctypes.c_uint64(0), ctypes.c_uint64(0)
            self._c.arv_gv_stream_get_statistics(self.handle, ctypes.byref(resent), ctypes.byref(missing))
            found |= {"packets_resent": resent.value, "packets_missing": missing.value}
        return found

    def _arrival(self, now_ns: int, age_ns: int, has_waited: bool) -> int:
        """When a picture was whole: now, if it was waited for. Else as long after its first packet as the fastest that was waited for."""
        if not 0 <= age_ns < _OLDEST_LEADER_NS:  # the clock of the day was set meanwhile
            return now_ns
        if has_waited:
            self._shortest_transfer_ns = min(self._shortest_transfer_ns, age_ns)
            return now_ns
        return min(now_ns, now_ns - age_ns + self._shortest_transfer_ns)


def negotiate_packet_size(aravis: Aravis, device: int, asked: int) -> None:
    """Before the stream is made: let packets be as large as the way carries (`asked` = 0), or as asked.

    An asked size is tried with test packets when the stream is made, where the camera has them; libaravis changes it if they do not arrive.

    Raises:
        AravisError: the device refuses.
    """
    if asked:
        aravis.c.arv_gv_device_set_packet_size(device, asked)
        aravis.c.arv_gv_device_set_packet_size_adjustment(device, PACKET_SIZE_ON_FAILURE_ONCE)
    else:
        aravis.c.arv_gv_device_auto_packet_size(device)
        aravis.c.arv_gv_device_set_packet_size_adjustment(device, PACKET_SIZE_NEVER)


def check_packet_size(aravis: Aravis, device: int, asked: int) -> int:
    """After the stream is made: size of packets, bytes.

    Raises:
        CaptureError: it is another than asked.
    """
    size = aravis.c.arv_gv_device_get_packet_size(device)
    if asked and size != asked:
        raise CaptureError(
            f"packets of packet_size = {asked} bytes do not arrive, or the camera does not make them; {size} would work; "
            "set packet_size = 0, or the MTU of the network higher (network card, switch and camera)"
        )
    return size

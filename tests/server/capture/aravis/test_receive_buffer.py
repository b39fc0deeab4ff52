"""The kernel's receive buffer: how much is wanted, what is granted, and what the user is told."""

import socket
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.capture.aravis.receive_buffer import (
    buffer_warning,
    enlarge_receive_buffer,
    wanted_bytes,
)


@given(st.integers(1, 1 << 30))
def test_at_least_two_pictures_fit_up_to_the_limit(payload_bytes: int) -> None:
    wanted = wanted_bytes(payload_bytes)
    assert 1 << 20 <= wanted <= 256 << 20
    assert wanted >= min(2 * payload_bytes, 256 << 20)
    assert wanted_bytes(payload_bytes + 1) >= wanted


def test_the_user_is_told_what_to_do() -> None:
    assert buffer_warning(2_000_000, 4_000_000) == ""  # two pictures
    assert buffer_warning(2_000_000, 212_992).endswith("sysctl -w net.core.rmem_max=6000000")  # three


def test_the_buffer_of_the_socket_itself_is_enlarged() -> None:
    limit = int(Path("/proc/sys/net/core/rmem_max").read_text())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        port = own.getsockname()[1]
        before = own.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
        wanted = min(limit, 2 * before)
        assert enlarge_receive_buffer(port, wanted) == pytest.approx(wanted, abs=1)
        assert own.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2 == pytest.approx(wanted, abs=1)
    assert enlarge_receive_buffer(port, wanted) == 0  # nobody has it now

"""Control is given up in the name of dead programs only, and what others may have written down is not believed."""

import socket
from pathlib import Path

import pytest
from tests.network_namespace import camera_address
from tests.server.capture.aravis.gige_camera import GigeCamera

from nearfield_server.capture.aravis.control_claim import claims_folder, give_up_for_the_dead, write_claim
from nearfield_server.capture.aravis.gvcp import PORT

pytestmark = pytest.mark.cameras


@pytest.fixture(autouse=True)
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def control(address: str) -> socket.socket:
    """Take control of a camera as another program would: write 2 to its control register (GigE Vision 2.0, 28)."""
    program = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    program.bind(("127.0.0.1", 0))
    program.settimeout(20.0)
    program.sendto(bytes([0x42, 1, 0, 0x82, 0, 8, 0, 1, 0, 0, 0x0A, 0, 0, 0, 0, 2]), (address, PORT))
    program.recv(100)
    return program


def test_the_control_of_a_dead_program_is_given_up_that_of_a_living_one_is_not() -> None:
    address = camera_address(92)
    with GigeCamera(address) as camera:
        with control(address) as program:
            write_claim(address, *program.getsockname())
            assert camera.controller == program.getsockname()
            assert not give_up_for_the_dead(address)
            assert camera.controller == program.getsockname()
        assert give_up_for_the_dead(address)
        assert camera.controller is None
        assert not give_up_for_the_dead(address)  # once is enough


def test_another_programs_control_is_left_alone() -> None:
    address = camera_address(92)
    with GigeCamera(address) as camera, control(address) as program:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as dead:
            dead.bind(("127.0.0.1", 0))
            write_claim(address, *dead.getsockname())
        assert not give_up_for_the_dead(address)
        assert camera.controller == program.getsockname()


@pytest.mark.parametrize(
    "content", ["", "127.0.0.1", "127.0.0.1 x", "127.0.0.1 99999999", "a b c", "nowhere 5"]
)
def test_a_damaged_note_is_ignored(content: str) -> None:
    claims_folder().mkdir(mode=0o700)
    (claims_folder() / "127.0.0.1").write_text(content)
    assert not give_up_for_the_dead("127.0.0.1")


def test_a_folder_where_others_may_write_is_not_used() -> None:
    claims_folder().mkdir()
    claims_folder().chmod(0o777)
    write_claim("127.0.0.1", "127.0.0.1", 5)
    assert list(claims_folder().iterdir()) == []

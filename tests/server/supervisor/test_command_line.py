"""The command line: fast help, errors in words, exit codes."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from nearfield_server.__main__ import exit_code
from nearfield_server.commands.lazy import COMMANDS
from nearfield_server.errors import AssetError, BusError, ConfigError, NearfieldError

TINY_ROOM = Path(__file__).parents[2] / "data" / "tiny_room"


def _run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "nearfield_server", *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "COLUMNS": "200", "TERM": "dumb", **environment},
        check=False,
    )


def test_help_lists_every_command() -> None:
    result = _run("--help")
    assert result.returncode == 0
    for name, entry in COMMANDS.items():
        assert name in result.stdout
        assert entry.summary in result.stdout


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; sys.argv = ['nearfield', '--help']\n"
        "from nearfield_server.__main__ import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "print('LOADED', sorted(set(sys.modules) & {'numpy', 'numba', 'zenoh', 'fastapi', 'moderngl', 'cv2', 'pydantic'}))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True
    )
    assert "LOADED []" in result.stdout


@pytest.mark.parametrize("command", ["serve", "demo"])
def test_every_option_is_explained(command: str) -> None:
    result = _run(command, "--help")
    assert result.returncode == 0
    assert "--port" in result.stdout
    assert "--lan" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("serve", "/nonexistent"), "no such room"),
        (("serve", str(TINY_ROOM), "--backend", "vulkan"), "expected auto, cpu, gl or reference"),
        (("serve", str(TINY_ROOM), "--ratio", "0"), "above 0"),
        (("serve", str(TINY_ROOM), "--full-well", "0"), "above 0"),
        (("bogus",), "No such command"),
    ],
)
def test_wrong_calls_are_told_in_words_with_exit_code_2(arguments: tuple[str, ...], words: str) -> None:
    result = _run(*arguments)
    assert result.returncode == 2
    assert words in result.stderr
    assert "Traceback" not in result.stderr


def test_an_unknown_sequence_is_told_in_words() -> None:
    result = _run("serve", str(TINY_ROOM), "--port", "0", "--sequence", "none-such")
    assert result.returncode == 2
    assert "no sequence 'none-such'" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_broken_room_file_is_told_in_words(tmp_path: Path) -> None:
    (tmp_path / "room.toml").write_text("format = 1\nnmae = 'x'\n")
    result = _run("serve", str(tmp_path), "--port", "0")
    assert result.returncode == 2
    assert "room.toml" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_port_in_use_is_told_in_words_with_exit_code_3() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        result = _run("serve", str(TINY_ROOM), "--port", str(port))
    assert result.returncode == 3
    assert f"port {port}" in result.stderr
    assert "--port" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("error", "code"),
    [(AssetError("x"), 1), (ConfigError("x"), 2), (BusError("x"), 3), (NearfieldError("x"), 3)],
)
def test_exit_codes_tell_kinds_of_errors_apart(error: NearfieldError, code: int) -> None:
    assert exit_code(error) == code

"""A file is there whole or not at all, and nothing else is left beside it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from nearfield_server.whole_file import whole_file


@pytest.mark.parametrize("is_durable", [False, True])
def test_the_file_appears_when_all_of_it_is_written(tmp_path: Path, is_durable: bool) -> None:
    path = tmp_path / "folder" / "file.bin"
    with whole_file(path, is_durable=is_durable) as partial:
        partial.write_bytes(b"first half")
        assert not path.exists()
        with partial.open("ab") as file:
            file.write(b", second half")
    assert path.read_bytes() == b"first half, second half"
    assert list(path.parent.iterdir()) == [path]
    # As readable as any other file that this user writes.
    (tmp_path / "other").write_bytes(b"")
    assert path.stat().st_mode == (tmp_path / "other").stat().st_mode


def test_an_error_leaves_the_file_before(tmp_path: Path) -> None:
    path = tmp_path / "file.bin"
    path.write_bytes(b"before")

    def interrupted() -> None:
        with whole_file(path) as partial:
            partial.write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_written_is_an_error_of_the_disk(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"), whole_file(tmp_path / "file.bin"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_two_writers_do_not_meet(tmp_path: Path) -> None:
    path = tmp_path / "file.bin"
    contents = [bytes([value]) * 300_000 for value in range(4)]

    def write(content: bytes) -> None:
        for _ in range(20):
            with whole_file(path) as partial:
                partial.write_bytes(content)

    writers = [threading.Thread(target=write, args=(content,)) for content in contents]
    for writer in writers:
        writer.start()
    while any(writer.is_alive() for writer in writers):
        assert not path.exists() or path.read_bytes() in contents
    assert list(tmp_path.iterdir()) == [path]


def test_who_dies_leaves_the_file_before(tmp_path: Path) -> None:
    path = tmp_path / "file.bin"
    path.write_bytes(b"before")
    program = (
        "import os, signal, sys; from pathlib import Path; from nearfield_server.whole_file import whole_file\n"
        "with whole_file(Path(sys.argv[1])) as partial:\n"
        "    partial.write_bytes(b'half'); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert path.read_bytes() == b"before"
    # What it had begun is hidden, and no pattern of ours finds it.
    assert [entry.name for entry in tmp_path.iterdir() if not entry.name.startswith(".")] == ["file.bin"]
    assert [entry for entry in os.listdir(tmp_path) if entry.endswith(".bin")] == ["file.bin"]

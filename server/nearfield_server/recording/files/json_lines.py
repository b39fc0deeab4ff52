"""Files of one JSON object per line, whose end may be missing because the writer was killed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from nearfield_server.recording.files.frame_info import parse_json

MAX_LINE_BYTES = 1 << 22


class LineWriter:
    """Appends lines; each is handed to the kernel whole and at once, so that it survives the end of this process.

    Raises:
        OSError: from every method, when the disk refuses.
    """

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        # A writer that was killed may have left half a line: it stays alone on its line.
        size = os.fstat(self._fd).st_size
        if size and os.pread(self._fd, 1, size - 1) != b"\n":
            os.write(self._fd, b"\n")

    def write(self, line: str) -> int:
        """Append a line and return its bytes. On a full disk the part that fitted is taken back."""
        data = line.encode() + b"\n"
        start = os.fstat(self._fd).st_size
        try:
            written = os.write(self._fd, data)
            if written != len(data):
                raise OSError(28, os.strerror(28))
        except OSError:
            os.ftruncate(self._fd, start)
            raise
        return len(data)

    def sync(self) -> None:
        """Wait until the disk has everything."""
        os.fdatasync(self._fd)

    def close(self) -> None:
        """Close; may be called twice."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


def read_lines(path: Path, problems: list[str]) -> Iterator[tuple[int, Any]]:
    """Yield (line number, value) of every line that is JSON; what is not is told in `problems` and passed over."""
    if not path.is_file():
        problems.append(f"{path}: missing")
        return
    with path.open("rb") as file:
        number = 0
        while line := file.readline(MAX_LINE_BYTES + 1):
            number += 1
            if len(line) > MAX_LINE_BYTES:
                problems.append(
                    f"{path}:{number}: longer than {MAX_LINE_BYTES} bytes; nothing after it is read"
                )
                return
            if not line.strip():
                continue
            try:
                value = parse_json(line)
            except ValueError as error:
                cut = (
                    "cut off, the recorder was killed here"
                    if not line.endswith(b"\n")
                    else f"not JSON ({error})"
                )
                problems.append(f"{path}:{number}: {cut}")
                continue
            yield number, value

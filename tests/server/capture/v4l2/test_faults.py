from __future__ import annotations

import errno
import os
import subprocess
from pathlib import Path

import pytest

from nearfield_server.capture.v4l2.faults import explain, holders_of


def test_holders_of_a_device_are_named() -> None:
    ours, theirs = os.openpty()
    terminal = os.ttyname(theirs)
    other = subprocess.Popen(["sleep", "600"], pass_fds=[theirs])
    try:
        assert holders_of(terminal) == [(other.pid, "sleep")]
        assert f"sleep (process {other.pid})" in str(
            explain(OSError(errno.EBUSY, "busy"), "cam0", terminal, "open the device")
        )
    finally:
        other.kill()
        other.wait()
        os.close(ours)
        os.close(theirs)


def test_nobody_holds_what_is_not_there(tmp_path: Path) -> None:
    assert holders_of(str(tmp_path / "video0")) == []


def test_a_missing_device_lists_its_neighbours(tmp_path: Path) -> None:
    (tmp_path / "usb-Other-video-index0").touch()
    error = explain(
        OSError(errno.ENOENT, "no such file"), "cam0", str(tmp_path / "usb-Mine"), "open the device"
    )
    assert f"Present: {tmp_path}/usb-Other-video-index0" in str(error)


@pytest.mark.parametrize(
    ("number", "words"), [(errno.ENOMEM, "smaller picture"), (errno.ENOTTY, "video capture node")]
)
def test_other_refusals_say_what_to_do(number: int, words: str) -> None:
    error = explain(OSError(number, "refused"), "", "/dev/video0", "set up the camera")
    assert str(error).startswith("/dev/video0: cannot set up the camera: ")
    assert words in str(error)

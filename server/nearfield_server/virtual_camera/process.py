"""A simulated camera as a process that is told by lines on its standard input what to do."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from typing import Final, TextIO

from nearfield_server.bus.worker import set_on_signals
from nearfield_server.errors import CaptureError, NearfieldError
from nearfield_server.virtual_camera.device import VirtualCamera
from nearfield_server.virtual_camera.faults import parse_command

_TEND_PERIOD_S: Final = 0.05


def serve(camera: VirtualCamera, commands: TextIO | None, answers: TextIO) -> None:
    """Run until told to end by a signal, or by the end of the commands.

    Args:
        camera: it runs already.
        commands: lines with one JSON object each, see `faults.parse_command`; an empty object only asks for a report. None = no commands.
        answers: one JSON object per command: "event" ("ready", "done" or "refused") and the report of the camera.

    Raises:
        CaptureError: the camera cannot draw its pictures.
    """
    stop = threading.Event()
    set_on_signals(stop)
    _answer(answers, "ready", camera.report())
    if commands is not None:
        threading.Thread(target=_obey, args=(camera, commands, answers, stop), daemon=True).start()
    while not stop.wait(_TEND_PERIOD_S):
        camera.tend()
        if camera.failure:
            raise CaptureError(f"test camera {camera.setup.serial}: {camera.failure}")


def _obey(camera: VirtualCamera, commands: TextIO, answers: TextIO, stop: threading.Event) -> None:
    for line in commands:
        try:
            camera.apply(parse_command(line, len(camera.state.lights)))
        except NearfieldError as error:
            _answer(answers, "refused", {"reason": str(error)})
        else:
            _answer(answers, "done", camera.report())
    stop.set()


def _answer(answers: TextIO, event: str, content: Mapping[str, object]) -> None:
    answers.write(json.dumps({"event": event, **content}) + "\n")
    answers.flush()

"""`nearfield record`: has a running service record, or starts one for it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from nearfield_server.commands.serve import recording_options
from nearfield_server.errors import ConfigError, ServiceError
from nearfield_server.recording.space import TYPICAL_RATIO, disk_space, most_bytes_per_second
from nearfield_server.scene.room_config import load_room
from nearfield_server.supervisor.control_socket import RunningService, running_services

_LOOK_S = 0.25
_START_LIMIT_S = 600.0
_END_LIMIT_S = 180.0


def record(
    room: Annotated[
        Path | None,
        typer.Argument(help="Room to record; without it, that of the service which runs on this machine."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="New folder for the recording.")] = None,
    seconds: Annotated[
        float | None,
        typer.Option(min=0.1, help="How long; default: until Ctrl-C or `nearfield record --stop`."),
    ] = None,
    kind: Annotated[
        str,
        typer.Option(
            "--format",
            help="exr: OpenEXR files, for any tool; raw: MCAP, a tenth of the work, for full rate.",
        ),
    ] = "exr",
    keep_free_mb: Annotated[
        int | None, typer.Option(min=0, help="Stop when less than this is free on the disk; default: 500 MB.")
    ] = None,
    queue_mb: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Most memory for frames that wait for the disk; default: 2000 MB or a quarter of what is free.",
        ),
    ] = None,
    stop: Annotated[bool, typer.Option("--stop", help="End the recording that runs.")] = False,
    rate: Annotated[
        float | None, typer.Option(min=0.1, max=240.0, help="Frames per second, where a service is started.")
    ] = None,
) -> None:
    """Record what the cameras of a room see, so that it can be replayed exactly. Ctrl-C ends the recording."""
    console = Console(stderr=True)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _interrupt)  # however this command is ended, the recording ends with it
    path = None if room is None else str(room.resolve())
    if stop:
        service = _chosen_service(path)
        if service is None:
            raise ServiceError("no service runs on this machine")
        service.ask({"command": "finish"})
        _wait_for_end(service, console)
        return
    if out is None:
        raise ConfigError("expected --out FOLDER, a new folder for the recording")
    options = recording_options(out, kind)
    if keep_free_mb is not None:
        options["reserve_bytes"] = keep_free_mb * 1_000_000
    if queue_mb is not None:
        options["queue_bytes"] = queue_mb * 1_000_000
    service = _chosen_service(path)
    with contextlib.ExitStack() as started:
        if service is None:
            if room is None:
                raise ConfigError(
                    "no service runs on this machine: start one with `nearfield serve ROOM`, or name a ROOM to record"
                )
            service = started.enter_context(_own_service(room, rate, console))
        _estimate(service, out, seconds, console)
        service.ask({"command": "record", **options})
        reason = _follow(service, seconds, console)
        _finish(service, console)
    if reason:
        raise ServiceError(reason)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _chosen_service(room_path: str | None) -> RunningService | None:
    """The service of a room, or the only one.

    Raises:
        ConfigError: several run, and it is not clear which is meant.
    """
    found: list[tuple[RunningService, dict[str, Any]]] = []
    for service in running_services():
        with contextlib.suppress(ServiceError):  # it ended just now
            found.append((service, service.ask({"command": "status"})))
    if room_path is not None:
        found = [entry for entry in found if entry[1].get("room_path") == room_path]
        if len(found) > 1:
            raise ConfigError(f"{len(found)} services of {room_path} run on this machine; end all but one")
    if len(found) > 1:
        rooms = ", ".join(str(status.get("room_path")) for _, status in found)
        raise ConfigError(f"several services run on this machine; name the room: {rooms}")
    return found[0][0] if found else None


@contextlib.contextmanager
def _own_service(room: Path, rate: float | None, console: Console) -> Iterator[RunningService]:
    """A service of our own for as long as the recording takes.

    Raises:
        ServiceError: it ends instead of starting.
    """
    load_room(room)  # a wrong room file is told here, once
    path = str(room.resolve())
    options = [] if rate is None else ["--rate", str(rate)]
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "nearfield_server", "serve", path, "--port", "0"),
            *("--end-with", str(os.getpid()), *options),
        ],
        stdin=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C ends the recording first
    )
    try:
        with console.status("the service starts"):
            service = _wait_until_ready(process, path)
        yield service
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()


def _wait_until_ready(process: subprocess.Popen[bytes], room_path: str) -> RunningService:
    end_s = time.monotonic() + _START_LIMIT_S
    while process.poll() is None and time.monotonic() < end_s:
        service = _chosen_service(room_path)
        if service is not None and service.ask({"command": "status"}).get("ready"):
            return service
        time.sleep(_LOOK_S)
    raise ServiceError("the service did not start; what it printed says why")


def _estimate(service: RunningService, out: Path, seconds: float | None, console: Console) -> None:
    """Say how much room the recording will take at the most."""
    status = service.ask({"command": "status"})
    room = load_room(status["room_path"])
    sizes = [(camera.intrinsics.height, camera.intrinsics.width) for camera in room.cameras]
    per_s = TYPICAL_RATIO * most_bytes_per_second(sizes, float(status["frame_rate"]))
    free = disk_space(out).free
    text = f"{len(sizes)} cameras, {status['frame_rate']:g} frames/s: about {per_s / 1e6:.0f} MB/s if every picture changes"
    if seconds is not None:
        text += f", {per_s * seconds / 1e9:.2f} GB for {seconds:g} s"
    console.print(
        f"{text}; {free / 1e9:.1f} GB free, enough for {free / per_s / 60:.0f} minutes",
        highlight=False,
        soft_wrap=True,
    )


def _follow(service: RunningService, seconds: float | None, console: Console) -> str:
    """Show progress until time is up, Ctrl-C comes, or the recording ends by itself; returns why it ended badly, if it did."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[numbers]}"),
    )
    with (
        contextlib.suppress(KeyboardInterrupt),
        Progress(*columns, console=console, transient=True) as progress,
    ):
        task = progress.add_task("recording", total=seconds, numbers="")
        while True:
            status = service.ask({"command": "status"})
            recording = status.get("recording", {})
            if not status["running"]:
                return ""
            if not recording and status["restarts"] > 2:
                return f"the recorder does not start: {status['last_fault']}"
            if recording.get("state") == "stopped":
                return str(recording["warning"])
            elapsed_s = float(recording.get("elapsed_s", 0.0))
            progress.update(task, completed=min(elapsed_s, seconds or elapsed_s), numbers=_numbers(recording))
            if seconds is not None and elapsed_s >= seconds:
                return ""
            time.sleep(min(_LOOK_S, max(0.01, (seconds or 1e9) - elapsed_s)))
    return ""


def _numbers(recording: dict[str, Any]) -> str:
    if not recording:
        return "starting"
    minutes = recording["minutes_left"]
    lost = recording["frames_dropped"]
    return (
        f"{recording['frames_written']} frames, {lost} lost, {recording['bytes_written'] / 1e6:.0f} MB, "
        f"{recording['megabytes_per_s']:.0f} MB/s, {recording['queue_mb']:.0f} MB wait, "
        f"{recording['free_mb'] / 1e3:.1f} GB free" + ("" if minutes is None else f" ({minutes:.0f} min)")
    )


def _finish(service: RunningService, console: Console) -> None:
    """End the recording and wait until everything is written."""
    with contextlib.suppress(ServiceError):  # it has ended by itself
        service.ask({"command": "finish"})
    _wait_for_end(service, console)


def _wait_for_end(service: RunningService, console: Console) -> None:
    end_s = time.monotonic() + _END_LIMIT_S
    with console.status("writing what waits"):
        while (status := service.ask({"command": "status"}))["running"]:
            if time.monotonic() > end_s:
                raise ServiceError("the recording does not end; see the log of the service")
            time.sleep(_LOOK_S)
    recording = status["recording"]
    if recording:
        console.print(f"{recording['folder']}: {_numbers(recording)}", highlight=False, soft_wrap=True)
        if recording["warning"]:
            console.print(recording["warning"], highlight=False, soft_wrap=True, style="yellow")

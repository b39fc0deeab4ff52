"""CPU time of Chromium's GPU process: what drawing costs on a machine that rasterises in software.

The kernel counts the time that every thread was on a CPU, so another load on the machine changes the figure far less than wall time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from nearfield_server.errors import ServiceError

_PROC: Final = Path("/proc")


def thread_time_ns(process_id: int, *, proc: Path = _PROC) -> int:
    """Nanoseconds that all living threads of a process have spent on a CPU so far.

    Args:
        process_id: of the process.
        proc: mount point of procfs.

    Raises:
        ServiceError: there is no such process, or this kernel keeps no schedstat.
    """
    total, found = 0, False
    for file in (proc / str(process_id) / "task").glob("*/schedstat"):
        try:
            fields = file.read_text(encoding="ascii").split()
        except (FileNotFoundError, ProcessLookupError):
            continue  # The thread has just ended.
        # Time on the CPU, time waiting for one, number of time slices (Documentation/scheduler/sched-stats.rst).
        total += int(fields[0])
        found = True
    if not found:
        raise ServiceError(
            f"{proc / str(process_id)}: no thread has a schedstat file; CPU time of the browser can be read on Linux only, "
            "while the browser runs"
        )
    return total


def process_ids_of(session: Any, kind: str) -> tuple[int, ...]:
    """Process ids of a part of the browser.

    Args:
        session: CDP session of the browser (playwright's `browser.new_browser_cdp_session()`).
        kind: "GPU", "renderer" or "browser".

    Raises:
        ServiceError: the browser has no such process.
    """
    processes = session.send("SystemInfo.getProcessInfo")["processInfo"]
    found = tuple(int(process["id"]) for process in processes if process["type"] == kind)
    if not found:
        kinds = sorted({process["type"] for process in processes})
        raise ServiceError(f"the browser has no {kind} process (found {kinds}); use a current Chromium")
    return found

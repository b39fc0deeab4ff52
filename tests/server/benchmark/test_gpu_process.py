"""CPU time of a process by its threads."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest

from nearfield_server.benchmark.gpu_process import process_ids_of, thread_time_ns
from nearfield_server.errors import ServiceError


def _thread(proc: Path, process: int, thread: int, text: str) -> None:
    folder = proc / str(process) / "task" / str(thread)
    folder.mkdir(parents=True)
    (folder / "schedstat").write_text(text)


def test_time_on_the_cpu_is_summed_over_threads(tmp_path: Path) -> None:
    _thread(tmp_path, 7, 7, "1000 999999 5\n")
    _thread(tmp_path, 7, 8, "234 0 1\n")
    _thread(tmp_path, 9, 9, "5000000 0 1\n")
    assert thread_time_ns(7, proc=tmp_path) == 1234


def test_a_thread_that_ended_meanwhile_is_left_out(tmp_path: Path) -> None:
    _thread(tmp_path, 7, 7, "1000 0 5\n")
    (tmp_path / "7" / "task" / "8").mkdir()
    (tmp_path / "7" / "task" / "8" / "schedstat").symlink_to(tmp_path / "gone")
    assert thread_time_ns(7, proc=tmp_path) == 1000


def test_a_missing_process_is_an_error_in_words(tmp_path: Path) -> None:
    with pytest.raises(ServiceError, match="schedstat"):
        thread_time_ns(7, proc=tmp_path)


def test_this_process_is_charged_for_the_work_of_its_threads() -> None:
    """The sum over threads grows with their work, and never beyond the CPU clock of the process."""
    release = threading.Event()

    def work() -> None:
        sum(range(2_000_000))
        release.wait(30)

    thread = threading.Thread(target=work)
    before = thread_time_ns(os.getpid())
    thread.start()
    while thread_time_ns(os.getpid()) - before < 1_000_000:
        sum(range(10_000))
    counted = thread_time_ns(os.getpid())
    assert counted <= time.process_time_ns()
    release.set()
    thread.join()


class _Session:
    def send(self, method: str) -> dict[str, list[dict[str, object]]]:
        assert method == "SystemInfo.getProcessInfo"
        kinds = [("browser", 1), ("GPU", 2), ("renderer", 3), ("renderer", 4)]
        return {"processInfo": [{"type": kind, "id": number, "cpuTime": 0.5} for kind, number in kinds]}


def test_processes_are_found_by_kind() -> None:
    assert process_ids_of(_Session(), "GPU") == (2,)
    assert process_ids_of(_Session(), "renderer") == (3, 4)
    with pytest.raises(ServiceError, match="no utility process"):
        process_ids_of(_Session(), "utility")

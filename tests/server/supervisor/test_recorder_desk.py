"""The recorder process: one at a time, started again when it dies, let go of when it has ended as asked."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

from nearfield_server.errors import ServiceError
from nearfield_server.supervisor.errand import Errands
from nearfield_server.supervisor.recorder_desk import FINISH_LIMIT_S, RecorderDesk


class FakeChild:
    """A process that does as it is told."""

    pid = 1

    def __init__(self) -> None:
        self.status: dict[str, Any] = {}
        self.restarts, self.last_fault = 0, ""
        self.calls: list[str] = []
        self.ended = False

    def start(self, now_s: float) -> None:
        self.calls.append("start")

    def watch(self, now_s: float) -> None:
        self.calls.append("watch")

    def has_ended(self) -> bool:
        return self.ended

    def terminate(self) -> None:
        self.calls.append("terminate")
        self.ended = True

    def finish(self, timeout_s: float) -> None:
        self.calls.append("finish")


class Office:
    """A desk with a fake process."""

    def __init__(self) -> None:
        self.child = FakeChild()
        self.asked = 0
        make: Any = lambda options: self.child  # noqa: E731
        self.desk = RecorderDesk(make, self._ask)

    def _ask(self) -> None:
        self.asked += 1


def test_a_recording_from_start_to_end(tmp_path: Path) -> None:
    office = Office()
    desk, child = office.desk, office.child
    assert desk.report() == {"running": False, "recording": {}}
    desk.start({"folder": str(tmp_path / "r"), "kind": "raw"}, 0.0)
    desk.watch(1.0)
    assert child.calls == ["start", "watch"]
    with pytest.raises(ServiceError, match="running already"):
        desk.start({"folder": str(tmp_path / "s"), "kind": "raw"}, 0.0)
    child.status = {"phase": "running", "state": "recording", "frames_written": 5}
    assert desk.report()["recording"]["frames_written"] == 5
    desk.finish(2.0)
    desk.finish(2.1)
    assert office.asked == 1
    desk.watch(3.0)
    assert desk.child is not None  # it still writes
    child.status = {"state": "ended", "frames_written": 7}
    desk.watch(4.0)
    assert desk.child is None
    assert "terminate" in child.calls
    assert desk.report() == {"running": False, "recording": {"state": "ended", "frames_written": 7}}
    with pytest.raises(ServiceError, match="no recording"):
        desk.finish(5.0)


def test_a_recorder_that_only_starts_is_asked_again(tmp_path: Path) -> None:
    office = Office()
    desk, child = office.desk, office.child
    desk.start({"folder": str(tmp_path / "r"), "kind": "raw"}, 0.0)
    desk.finish(0.1)
    desk.watch(0.2)
    assert office.asked == 1
    desk.watch(1.0)
    assert office.asked == 2
    child.status = {"state": "finishing"}
    desk.watch(2.0)
    desk.watch(3.0)
    assert office.asked == 2


def test_a_recorder_that_does_not_end_is_ended(tmp_path: Path) -> None:
    office = Office()
    office.desk.start({"folder": str(tmp_path / "r"), "kind": "exr"}, 0.0)
    office.desk.finish(0.0)
    office.desk.watch(FINISH_LIMIT_S - 1)
    assert office.desk.child is not None
    office.desk.watch(FINISH_LIMIT_S + 1)
    assert office.desk.child is None
    assert office.child.calls[-1] == "finish"


@pytest.mark.parametrize(
    "options", [{}, {"folder": "relative", "kind": "raw"}, {"folder": "/tmp/x", "kind": "avi"}, {"folder": 5}]
)
def test_wrong_options_are_refused_before_anything_is_started(options: dict[str, Any]) -> None:
    office = Office()
    with pytest.raises(ServiceError, match="absolute folder and a kind"):
        office.desk.start(options, 0.0)
    assert office.child.calls == []


def test_only_a_new_folder_is_recorded_into_unless_it_is_the_next_take(tmp_path: Path) -> None:
    (tmp_path / "something").write_text("")
    office = Office()
    with pytest.raises(ServiceError, match="new or empty"):
        office.desk.start({"folder": str(tmp_path), "kind": "raw"}, 0.0)
    office.desk.start({"folder": str(tmp_path), "kind": "raw"}, 0.0, is_new=False)
    assert office.child.calls == ["start"]


def test_errands_are_done_in_the_main_thread_and_bring_back_result_or_error() -> None:
    errands: Errands[str] = Errands()
    found: list[str] = []

    def fail() -> str:
        raise ServiceError("no")

    def ask() -> None:
        found.append(errands.request(lambda: threading.current_thread().name, 60.0))
        try:
            errands.request(fail, 60.0)
        except ServiceError as error:
            found.append(str(error))

    asker = threading.Thread(target=ask)
    asker.start()
    while asker.is_alive():
        errands.run()
        asker.join(0.01)
    assert found == [threading.current_thread().name, "no"]
    with pytest.raises(ServiceError, match="busy"):
        errands.request(lambda: "", 0.01)
    errands.run()  # the one that nobody waits for any more

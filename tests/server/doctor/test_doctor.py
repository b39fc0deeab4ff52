"""The whole examination, the command, and the one machine that is really here."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from nearfield_server.commands import doctor as command
from nearfield_server.doctor.examination import examine
from nearfield_server.doctor.finding import Level, as_json, as_text, has_problem, ok, problem, warning
from nearfield_server.doctor.machine import Machine, ThisMachine
from nearfield_server.onboarding.gige import AnsweringCamera

from .conftest import FakeMachine, gige_camera, write_room


def _examine(machine: Machine, room: Path | None, folder: Path) -> dict[str, Level]:
    (folder / "index.html").touch()
    findings = examine(machine, room, static_dir=folder, recordings=folder)
    return {finding.check: finding.level for finding in findings}


def test_a_machine_in_order_has_nothing_to_mend(machine: FakeMachine, tmp_path: Path) -> None:
    machine.cameras = {f"192.168.10.2{index}": gige_camera(f"192.168.10.2{index}") for index in range(2)}
    sources = [f'kind = "aravis", address = "{address}"' for address in machine.cameras]
    levels = _examine(machine, write_room(tmp_path, *sources), tmp_path)
    assert set(levels.values()) == {Level.OK}, levels
    assert {"room", "camera cam0", "camera cam1", "link enp3s0", "receive buffer"} <= set(levels)
    assert machine.asked == list(machine.cameras)


def test_a_wrong_room_file_does_not_hide_the_rest(machine: FakeMachine, tmp_path: Path) -> None:
    room = write_room(tmp_path, 'kind = "aravis", adress = "192.168.10.21"')
    machine.python = "3.8.0"
    levels = _examine(machine, room, tmp_path)
    assert levels["room"] is Level.PROBLEM
    assert levels["python"] is Level.PROBLEM
    assert "memory" in levels


def test_ptp_in_the_room_asks_for_a_daemon(machine: FakeMachine, tmp_path: Path) -> None:
    source = 'kind = "aravis", serial = "1", features = { PtpEnable = true }'
    assert _examine(machine, write_room(tmp_path, source), tmp_path)["clock"] is Level.WARNING


def test_without_a_room_no_camera_is_asked(machine: FakeMachine, tmp_path: Path) -> None:
    assert Level.PROBLEM not in _examine(machine, None, tmp_path).values()
    assert machine.asked == []


def test_lines_for_people_and_json_for_programs() -> None:
    findings = [
        ok("a", "fine"),
        warning("long name", "slow", "do this"),
        problem("c", "broken", "do that\nand that"),
    ]
    assert as_text(findings).splitlines() == [
        "ok       a          fine",
        "warning  long name  slow",
        "                    do this",
        "problem  c          broken",
        "                    do that",
        "                    and that",
        "",
        "1 problems, 1 warnings, 1 ok",
    ]
    assert "\x1b[31mproblem" in as_text(findings, colour=True)
    told = json.loads(as_json(findings))
    assert told["ok"] is False
    assert told["findings"][1] == {
        "check": "long name",
        "level": "warning",
        "text": "slow",
        "mend": "do this",
    }
    assert has_problem(findings)
    assert not has_problem(findings[:2])


def test_the_command(machine: FakeMachine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "ThisMachine", lambda: machine)
    monkeypatch.setattr(command, "BUILT_CLIENT", tmp_path)
    app = typer.Typer()
    app.command()(command.doctor)
    room = write_room(tmp_path, 'kind = "aravis", address = "192.168.10.21"')
    broken = CliRunner().invoke(app, [str(room), "--json"])
    assert broken.exit_code == 1
    wrong = {entry["check"] for entry in json.loads(broken.stdout)["findings"] if entry["level"] == "problem"}
    assert wrong == {"page", "camera cam0"}
    (tmp_path / "index.html").touch()
    machine.cameras["192.168.10.21"] = gige_camera("192.168.10.21")
    healthy = CliRunner().invoke(app, [str(room)])
    assert healthy.exit_code == 0, healthy.output
    assert "0 problems" in healthy.stdout


class QuietMachine(ThisMachine):
    """This machine, but no camera is asked."""

    def ask_gige(self, address: str) -> AnsweringCamera:
        raise AssertionError(address)


def test_this_machine_answers_every_question(tmp_path: Path) -> None:
    machine = QuietMachine()
    assert {"python", "packages", "graphics", "memory", "clock", "disk"} <= set(
        _examine(machine, None, tmp_path)
    )
    assert machine.read("/proc/sys/net/core/rmem_max").isdecimal()  # type: ignore[union-attr]
    assert machine.read("/nowhere") is None
    assert machine.read("/proc/1/mem") is None
    assert "/proc/self" in machine.names("/proc/sel*")
    assert machine.package_version("numpy")
    assert machine.package_version("no-such-package") is None
    assert any(line.startswith("numpy") for line in machine.requirements())
    assert not any("extra ==" in line for line in machine.requirements())
    assert machine.may_use(str(tmp_path))
    free = machine.free_bytes(tmp_path / "not" / "there" / "yet")
    assert free == pytest.approx(machine.free_bytes(tmp_path), rel=0.1)


def test_a_taken_port_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        assert "in use" in ThisMachine().why_taken("127.0.0.1", listener.getsockname()[1])
    assert ThisMachine().why_taken("127.0.0.1", 0) == ""

"""The light log: every bit back, and after damage nothing that does not follow from what is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.recording.files.json_lines import LineWriter
from nearfield_server.recording.files.light_log import (
    LIGHT_FILE,
    LightBegin,
    LightStep,
    line_of,
    read_light_log,
    step_from_fields,
)
from nearfield_server.records import ObjectPlacement

_POSE = st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=16, max_size=16)
_OBJECTS = st.lists(st.tuples(st.integers(0, 2**32 - 1), _POSE), max_size=3)


@given(st.lists(st.none() | st.integers(1, 2**60), max_size=8), st.none() | _OBJECTS, st.none() | st.binary())
def test_an_update_comes_back_bit_for_bit(
    frames: list[int | None], objects: object, packet: bytes | None
) -> None:
    states = None
    if objects is not None:
        states = tuple(
            ObjectPlacement(revision=revision, world_from_object=np.array(pose).reshape(4, 4))
            for revision, pose in objects  # type: ignore[attr-defined]
        )
    step = LightStep(run=1, number=2, frames=tuple(frames), objects=states, packet=packet)
    back = step_from_fields(step.to_fields())
    assert (back.frames, back.packet, back.number, back.run) == (step.frames, step.packet, 2, 1)
    assert (back.objects is None) == (states is None)
    for old, new in zip(states or (), back.objects or (), strict=True):
        assert old.revision == new.revision
        assert old.world_from_object.tobytes() == new.world_from_object.tobytes()


def _write(folder: Path) -> bytes:
    lines = LineWriter(folder / LIGHT_FILE)
    pose = (ObjectPlacement(revision=1, world_from_object=np.eye(4)),)
    for run in (1, 2):
        begin = LightBegin(run=run, first_sequence=10, backend="cpu", room_revision=5)
        lines.write(line_of(1, begin.to_fields()))
        for number in range(1, 6):
            step = LightStep(
                run=run,
                number=number,
                frames=(number, None),
                objects=pose if number == 1 else None,
                packet=b"x",
            )
            lines.write(line_of(1, step.to_fields()))
    lines.write(line_of(1, {"kind": "end"}))
    lines.close()
    return (folder / LIGHT_FILE).read_bytes()


def test_a_log_cut_anywhere_gives_back_the_updates_before_the_cut(tmp_path: Path) -> None:
    whole = _write(tmp_path)
    line_ends = [position for position, byte in enumerate(whole) if byte == ord("\n")]
    for cut in range(0, len(whole), 17):
        (tmp_path / LIGHT_FILE).write_bytes(whole[:cut])
        runs = read_light_log(tmp_path, [])
        # Lines 0 and 6 are begins; a line counts once its last character is there.
        lines = sum(end <= cut for end in line_ends)
        assert sum(len(run.updates) for run in runs) == sum(index not in (0, 6, 12) for index in range(lines))


def test_a_gap_ends_its_run_and_the_next_run_counts(tmp_path: Path) -> None:
    lines = _write(tmp_path).decode().splitlines(keepends=True)
    (tmp_path / LIGHT_FILE).write_text("".join(lines[:2] + lines[3:]))
    problems: list[str] = []
    runs = read_light_log(tmp_path, problems)
    assert [[step.number for step in run.updates] for run in runs] == [[1], [1, 2, 3, 4, 5]]
    assert "update 3 where 2 is expected" in problems[0]


@pytest.mark.parametrize(
    "line",
    [
        "7",
        '{"kind":"update","take":1,"run":1,"number":2,"frames":[0]}',
        '{"kind":"update","take":1,"run":1,"number":2,"frames":["a"]}',
        '{"kind":"update","take":1,"run":1,"number":2,"frames":[1],"packet":"%%"}',
        '{"kind":"update","take":1,"run":1,"number":2,"frames":[1],"packet":5}',
        '{"kind":"update","take":1,"run":1,"number":2,"frames":[1],"objects":[[1,[1,2]]]}',
        '{"kind":"update","take":1,"run":1,"number":2,"frames":[1],"objects":[[1,["a"]]]}',
        '{"kind":"update","take":1,"run":9,"number":2,"frames":[1]}',
        '{"kind":"update","take":1,"run":1,"number":1e99,"frames":[1]}',
        '{"kind":"begin","take":1,"run":-1}',
    ],
)
def test_hostile_lines_are_told_and_end_the_run(tmp_path: Path, line: str) -> None:
    lines = _write(tmp_path).decode().splitlines(keepends=True)
    (tmp_path / LIGHT_FILE).write_text("".join([*lines[:2], line + "\n", *lines[2:]]))
    problems: list[str] = []
    runs = read_light_log(tmp_path, problems)
    assert [len(run.updates) for run in runs] == [1, 5]
    assert f"{LIGHT_FILE}:3:" in problems[0]


def test_a_line_goes_on_after_half_a_line(tmp_path: Path) -> None:
    path = tmp_path / "lines.jsonl"
    path.write_bytes(b'{"a":1}\n{"b":')
    writer = LineWriter(path)
    writer.write('{"c":3}')
    writer.close()
    assert path.read_bytes() == b'{"a":1}\n{"b":\n{"c":3}\n'

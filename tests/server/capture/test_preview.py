"""Previews out of a ring."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from nearfield_server.bus.messages import PreviewRequest
from nearfield_server.capture import preview
from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.preview import PreviewPainter
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.errors import BusError

SHAPE = RingShape(48, 64, 3)
QUESTION = PreviewRequest(max_side=32).to_json()


@pytest.fixture
def ring() -> Iterator[tuple[FrameRingWriter, FrameRingReader]]:
    fd = create_ring("cam0", SHAPE)
    writer, reader = FrameRingWriter(fd, "cam0"), FrameRingReader(fd, "cam0")
    yield writer, reader
    reader.close()
    writer.close()
    os.close(fd)


def _write(writer: FrameRingWriter, revision: int, left: float, right: float) -> None:
    with writer.write(revision, revision) as draft:
        draft.pixels[:, :32], draft.pixels[:, 32:] = left, right
        draft.pixels[..., 3] = 1.0
        draft.counters[...] = 0


def _decode(data: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


def test_the_newest_frame_is_painted(ring: tuple[FrameRingWriter, FrameRingReader]) -> None:
    writer, reader = ring
    painter = PreviewPainter(reader)
    assert painter.answer(QUESTION) == b""
    _write(writer, 1, 4.0, 0.1)
    picture = _decode(painter.answer(QUESTION))
    assert picture.shape == (24, 32, 3)
    assert picture[:, :12].min() > picture[:, 20:].max()
    _write(writer, 2, 0.1, 4.0)
    picture = _decode(painter.answer(QUESTION))
    assert picture[:, :12].max() < picture[:, 20:].min()


def test_a_still_picture_is_painted_once(
    ring: tuple[FrameRingWriter, FrameRingReader], monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, reader = ring
    _write(writer, 1, 4.0, 0.1)
    painter = PreviewPainter(reader)
    first = painter.answer(QUESTION)
    with monkeypatch.context() as patch:
        patch.delattr(preview, "paint_preview")
        assert painter.answer(QUESTION) == first
    assert painter.answer(PreviewRequest(max_side=16).to_json()) != first


def test_a_frame_overwritten_while_it_was_painted_is_painted_again(
    ring: tuple[FrameRingWriter, FrameRingReader], monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, reader = ring
    _write(writer, 1, 4.0, 0.1)
    paint, revisions = preview.paint_preview, iter(range(2, 100))

    def overtaken(*arguments: object, **options: object) -> np.ndarray:
        painted = paint(*arguments, **options)  # type: ignore[arg-type]
        while next(revisions) < 6:  # once around the ring
            _write(writer, reader.newest().sequence + 1, 0.1, 4.0)  # type: ignore[union-attr]
        return painted

    monkeypatch.setattr(preview, "paint_preview", overtaken)
    picture = _decode(PreviewPainter(reader).answer(QUESTION))
    assert picture[:, :12].max() < picture[:, 20:].min()


@pytest.mark.parametrize(
    "change",
    [{"max_side": 8}, {"max_side": 4096}, {"stops": 1e3}, {"stops": float("nan")}, {"stops": "bright"}],
)
def test_malformed_questions_are_refused(change: dict[str, object]) -> None:
    question = {**json.loads(QUESTION), **change}
    with pytest.raises(BusError, match="preview"):
        PreviewRequest.from_json(json.dumps(question).encode())


def test_requests_pass_unchanged() -> None:
    request = PreviewRequest(max_side=256, stops=-1.5, marks=False)
    assert PreviewRequest.from_json(request.to_json()) == request

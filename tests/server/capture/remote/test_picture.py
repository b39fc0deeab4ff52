"""Whatever is lost on the way: the picture that arrives is one that was sent, bit for bit, and the newest once messages get through."""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.capture.frame_ring import FrameRingReader, FrameRingWriter
from nearfield_server.capture.ingest import as_words, ingest_frame
from nearfield_server.capture.remote.frame_sender import FrameSender
from nearfield_server.capture.remote.messages import FrameEncoder, Wish
from nearfield_server.capture.remote.picture import RemotePicture
from nearfield_server.capture.ring_memory import RingShape, create_ring
from nearfield_server.errors import CaptureError

HEIGHT, WIDTH = 70, 101
SHAPE = RingShape(HEIGHT, WIDTH, 3)
SECOND = 1_000_000_000


class Node:
    """A ring with a writer, and a sender that reads it."""

    def __init__(self, session: int = 1, *, tiles_only: bool = True, compression: str = "zstd") -> None:
        self._fd = create_ring("test", SHAPE)
        self.writer, self.reader = FrameRingWriter(self._fd, "w"), FrameRingReader(self._fd, "r")
        self.sender = FrameSender(
            session=session,
            encoder=FrameEncoder(compression),
            period_us=100_000,
            tiles_only=tiles_only,
        )
        self.sent: list[bytes] = []
        self._revision, self._now = 0, 0
        self._pixels = np.ones((HEIGHT, WIDTH, 4), np.float32)

    def change(self, row: int, column: int, value: float) -> None:
        """The camera sees one pixel change."""
        self._pixels[row % HEIGHT, column % WIDTH, 0] = value
        self._revision += 1
        with self.writer.write(self._revision, self._revision) as draft:
            ingest_frame(self._pixels, draft.pixels, previous=draft.previous, changed=draft.changed)

    def send(self) -> bytes | None:
        """The message for the newest frame; kept with the picture that it stands for."""
        self._now += SECOND
        view = self.reader.newest()
        assert view is not None
        return self.sender.next_message(view, self._now)

    @property
    def newest(self) -> np.ndarray:
        view = self.reader.newest()
        assert view is not None
        return as_words(view.pixels).copy()

    def close(self) -> None:
        self.writer.close()
        self.reader.close()
        os.close(self._fd)


def _words(picture: RemotePicture) -> np.ndarray:
    return as_words(picture.pixels)


def _wish(picture: RemotePicture) -> Wish:
    return Wish(session=picture.session, revision=picture.revision, asked_ns=0)


steps = st.lists(
    st.tuples(
        st.integers(0, HEIGHT - 1),
        st.integers(0, WIDTH - 1),
        st.floats(0, 1000, width=16),
        st.booleans(),  # this message is lost
        st.booleans(),  # the acknowledgement is lost
        st.integers(0, 2),  # messages that overtake it
    ),
    min_size=1,
    max_size=25,
)


@given(steps, st.booleans())
def test_every_picture_that_arrives_is_one_that_was_sent(
    script: list[tuple[int, int, float, bool, bool, int]], tiles_only: bool
) -> None:
    node, picture = Node(tiles_only=tiles_only), RemotePicture(HEIGHT, WIDTH)
    try:
        pictures: dict[int, np.ndarray] = {}
        under_way: list[bytes] = []
        for row, column, value, lost, unheard, delay in script:
            node.change(row, column, value)
            view = node.reader.newest()
            assert view is not None
            pictures[view.content_revision] = node.newest
            message = node.send()
            if message is not None and not lost:
                under_way.insert(max(0, len(under_way) - delay), message)
            if len(under_way) > 1:
                picture.take(under_way.pop(0))
            if picture.revision:
                assert np.array_equal(_words(picture), pictures[picture.revision])
            if not unheard:
                node.sender.acknowledge(_wish(picture))
        for message in under_way:
            picture.take(message)
        node.sender.acknowledge(_wish(picture))
        node.change(0, 0, 2000.0)
        last = node.send()
        assert last is not None
        assert picture.take(last) is not None
        assert np.array_equal(_words(picture), node.newest)
    finally:
        node.close()


def test_only_tiles_that_changed_are_sent_and_unchanged_pictures_are_confirmed() -> None:
    node, picture = Node(compression="none"), RemotePicture(HEIGHT, WIDTH)
    try:
        node.change(0, 0, 5.0)
        whole = node.send()
        assert whole is not None
        assert len(whole) > HEIGHT * WIDTH * 8
        assert picture.take(whole) is not None
        node.sender.acknowledge(_wish(picture))
        assert node.send() is None  # nothing new, not even a confirmation by the camera
        node.writer.confirm(77)
        confirmation = node.send()
        assert confirmation is not None
        assert len(confirmation) < 100
        header = picture.take(confirmation)
        assert header is not None
        assert (header.confirmed_ns, picture.content_revision) == (77, 1)
        node.change(40, 0, 6.0)
        tile = node.send()
        assert tile is not None
        assert 32 * 32 * 8 <= len(tile) < 32 * 32 * 8 + 100
        assert picture.take(tile) is not None
        assert picture.content_revision == 2
        assert np.array_equal(_words(picture), node.newest)
    finally:
        node.close()


def test_a_message_under_way_is_not_repeated_at_once() -> None:
    node = Node()
    try:
        node.change(0, 0, 5.0)
        view = node.reader.newest()
        assert view is not None
        assert node.sender.next_message(view, SECOND) is not None
        assert node.sender.next_message(view, SECOND + SECOND // 100) is None
        assert node.sender.next_message(view, 2 * SECOND) is not None
    finally:
        node.close()


def test_a_service_that_starts_anew_gets_a_whole_picture() -> None:
    node, first, second = Node(), RemotePicture(HEIGHT, WIDTH), RemotePicture(HEIGHT, WIDTH)
    try:
        for picture in (first, second):
            node.sender.acknowledge(_wish(picture))
            node.change(3, 3, 7.0 + picture.sessions)
            node.change(3, 3, 9.0)
            message = node.send()
            assert message is not None
            assert picture.take(message) is not None
            assert np.array_equal(_words(picture), node.newest)
    finally:
        node.close()


def test_a_node_that_starts_anew_replaces_the_picture() -> None:
    old, new, picture = Node(session=1), Node(session=2), RemotePicture(HEIGHT, WIDTH)
    try:
        old.change(0, 0, 1.0)
        old.change(0, 0, 2.0)
        message = old.send()
        assert message is not None
        assert picture.take(message) is not None
        new.sender.acknowledge(_wish(picture))  # of the old session: means nothing to the new one
        new.change(50, 50, 3.0)
        message = new.send()
        assert message is not None
        assert picture.take(message) is not None
        assert np.array_equal(_words(picture), new.newest)
        assert (picture.sessions, picture.content_revision) == (2, 2)
    finally:
        old.close()
        new.close()


def test_a_picture_that_missed_something_stays_as_it_is() -> None:
    node, picture, other = Node(), RemotePicture(HEIGHT, WIDTH), RemotePicture(HEIGHT, WIDTH)
    try:
        for turn, takers in enumerate(((picture, other), (other,))):
            node.change(0, 0, 1.0 + turn)
            message = node.send()
            assert message is not None
            for taker in takers:
                assert taker.take(message) is not None
        before = _words(picture).copy()
        node.sender.acknowledge(_wish(other))
        node.change(60, 60, 3.0)
        message = node.send()
        assert message is not None
        assert picture.take(message) is None
        assert (picture.missed, picture.content_revision) == (1, 1)
        assert np.array_equal(_words(picture), before)
        assert other.take(message) is not None
        assert np.array_equal(_words(other), node.newest)
        with pytest.raises(CaptureError):
            other.take(message[:-1])
    finally:
        node.close()

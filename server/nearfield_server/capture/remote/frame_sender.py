"""Which tiles a node sends: those that changed since the picture that the service says it has. Pure, no network."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nearfield_server.capture.frame_ring import FrameView
from nearfield_server.capture.ingest import as_words
from nearfield_server.capture.remote.messages import FrameEncoder, FrameHeader, Wish

_RESEND_NS = 200_000_000


@dataclass(slots=True)
class FrameSender:
    """Turns frames of a ring into messages.

    The service acknowledges what has arrived; a message holds every tile that changed after that. So a lost message costs nothing but
    itself, a service that starts anew gets a whole picture at once, and nothing has to be repeated on a schedule.

    Attributes:
        session: random number of this process, not 0.
        encoder: makes the messages.
        period_us: time between frames that this camera aims at.
        tiles_only: false = every message holds the whole picture.
        frames: messages with tiles so far. confirmations: those without. bytes_sent: of both.
    """

    session: int
    encoder: FrameEncoder
    period_us: int
    tiles_only: bool = True
    frames: int = 0
    confirmations: int = 0
    bytes_sent: int = 0
    tiles_sent: int = 0
    _arrived: int = 0
    _sent_revision: int = 0
    _sent_ns: int = 0
    _confirmed_ns: int = 0

    def acknowledge(self, wish: Wish) -> None:
        """Note what the service has."""
        self._arrived = wish.revision if wish.session == self.session else 0

    def next_message(self, view: FrameView, now_ns: int) -> bytes | None:
        """Return what is to be sent now, or None.

        Args:
            view: the newest frame of the ring.
            now_ns: CLOCK_MONOTONIC of this machine.

        Returns:
            The message; None if there is nothing to say, or if the ring's writer overtook the reading.
        """
        base = self._arrived if self.tiles_only else 0
        # A message on its way is not repeated before its acknowledgement can be back, nor overtaken by a confirmation of it.
        if self._arrived == view.content_revision:
            if view.confirmed_ns == self._confirmed_ns:
                return None
            base = view.content_revision
        elif self._sent_revision == view.content_revision and now_ns - self._sent_ns < _RESEND_NS:
            return None
        tiles = view.tile_revisions > base
        header = FrameHeader(
            width=view.pixels.shape[1],
            height=view.pixels.shape[0],
            session=self.session,
            revision=view.content_revision,
            base=base,
            timestamp_ns=view.timestamp_ns,
            confirmed_ns=view.confirmed_ns,
            period_us=self.period_us,
            metadata=view.metadata,
        )
        message = self.encoder.encode(header, tiles, as_words(view.pixels))
        if not view.still_valid():
            return None
        self._confirmed_ns = view.confirmed_ns
        self.bytes_sent += len(message)
        if base == view.content_revision:
            self.confirmations += 1
            return message
        self.frames += 1
        self.tiles_sent += int(np.count_nonzero(tiles))
        self._sent_revision, self._sent_ns = view.content_revision, now_ns
        return message

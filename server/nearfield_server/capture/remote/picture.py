"""The picture that the service has of a remote camera, kept up to date by messages of which any may be missing. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nearfield_server.capture.remote.messages import FrameHeader, decode_frame


@dataclass(slots=True)
class RemotePicture:
    """Puts frames together.

    A message holds all tiles that changed between its base and its revision. Pasted onto any picture in between it gives that of its
    revision exactly; a picture older than the base has missed something and stays as it is, and the acknowledgement says so.

    Attributes:
        height: pixels. width: pixels.
        session: whose pictures these are; 0 before the first.
        revision: of the picture within the session; 0 before the first.
        content_revision: counts up with every change, over all sessions.
        sessions: how many different ones there have been.
        missed: messages whose base had not arrived.
        late: messages older than the picture.
    """

    height: int
    width: int
    session: int = 0
    revision: int = 0
    content_revision: int = 0
    sessions: int = 0
    missed: int = 0
    late: int = 0
    _words: NDArray[np.uint64] = field(init=False)

    def __post_init__(self) -> None:
        self._words = np.zeros((self.height, self.width), np.uint64)

    @property
    def pixels(self) -> NDArray[np.float16]:
        """(height, width, 4) half floats; the same memory from message to message."""
        return self._words.view(np.float16).reshape(self.height, self.width, 4)

    def take(self, message: bytes) -> FrameHeader | None:
        """Take one message.

        Returns:
            Its header if the picture is now that of the message, None if the message does not fit onto it.

        Raises:
            CaptureError: the message is damaged, hostile or of another size; the picture stays as it was.
        """
        frame = decode_frame(message, self.height, self.width)
        header = frame.header
        same = header.session == self.session
        if same and header.revision < self.revision:
            self.late += 1
            return None
        if header.base > (self.revision if same else 0):
            self.missed += 1
            return None
        if not same or header.revision > self.revision:
            frame.paste(self._words)
            self.sessions += not same
            self.session, self.revision = header.session, header.revision
            self.content_revision += 1
        return header

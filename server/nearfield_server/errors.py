"""All deliberate errors of the server.

    NearfieldError
    |- ConfigError          a room file, setting or command line value is wrong
    |- AssetError           a file (GLB, EXR, bundle, prepared model) is broken or missing
    |- CaptureError         a camera or frame source fails
    |  |- FrameRingError    shared memory does not hold what its header promises
    |  `- AravisError       what libaravis reported (capture/aravis/library.py)
    |- GraphicsError        no usable OpenGL context, or a GL call failed
    |- BusError             the message bus cannot be opened or a message is malformed
    `- ServiceError         a process of the service cannot start or keep running (port in use, ...)

A message says what happened, where (file:key, camera, process), what was expected and found, and what to do.
"""

from __future__ import annotations


class NearfieldError(Exception):
    """Base of all deliberate errors; printed to users without a traceback."""


class ConfigError(NearfieldError):
    """A room file, setting or command line value is wrong."""


class AssetError(NearfieldError):
    """A file (GLB, EXR, bundle, prepared model) is broken or missing."""


class CaptureError(NearfieldError):
    """A camera or frame source fails."""


class AwayError(CaptureError):
    """Who should deliver frames is away for now; asking again costs nothing, so it is done at least once a second."""


class FrameRingError(CaptureError):
    """Shared memory does not hold what its header promises."""


class GraphicsError(NearfieldError):
    """No usable OpenGL context, or a GL call failed."""


class BusError(NearfieldError):
    """The message bus cannot be opened or a message is malformed."""


class ServiceError(NearfieldError):
    """A process of the service cannot start or keep running."""

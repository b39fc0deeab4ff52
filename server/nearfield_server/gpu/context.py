"""A headless OpenGL context with the checks that moderngl leaves out.

moderngl does not raise when an allocation fails; it only sets the error flag. Every allocation here is checked. A context
belongs to the thread that made it, and must not exist before a fork (the child would hang): start processes with
`subprocess`.
"""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import GraphicsError

_REQUIRED_VERSION = 430
_HEADLESS: dict[str, Any] = {"standalone": True, "backend": "egl"}
_SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "swiftshader")
# Living contexts of each thread, newest last: releasing one makes the one before it current again.
_LIVING = threading.local()


class GlContext:
    """One OpenGL 4.3 context; use `open_context` to make it and `release` (or `with`) to free everything in it.

    Attributes:
        renderer: name that the driver gives itself.
        is_software: the renderer runs on the processor, where the numba kernels are faster.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context: Any = context
        self._thread = threading.get_ident()
        self._is_released = False
        self.renderer = str(context.info["GL_RENDERER"])
        self.is_software = any(name in self.renderer.lower() for name in _SOFTWARE_RENDERERS)
        self._idle: Any = self.framebuffer([self.texture(1, 1, 4, "f1")])

    @property
    def gl(self) -> Any:
        """The moderngl context, for draws and state.

        Raises:
            GraphicsError: released, or used from another thread.
        """
        if self._is_released:
            raise GraphicsError("OpenGL context: already released. Open a new one.")
        if threading.get_ident() != self._thread:
            raise GraphicsError(
                "OpenGL context: used from a thread that did not open it. Open one per thread."
            )
        return self._context

    def check(self, where: str) -> None:
        """Raise if OpenGL has flagged an error since the last check.

        Raises:
            GraphicsError: with the name of the OpenGL error.
        """
        error = self.gl.error
        if error != "GL_NO_ERROR":
            raise GraphicsError(f"{where}: {error} on renderer {self.renderer!r}.")

    def storage_buffer(self, values: NDArray[Any]) -> Any:
        """Shader storage buffer that holds a copy of an array (any shape, at least one byte)."""
        data = np.ascontiguousarray(values)
        buffer = self._allocate(f"buffer of {data.nbytes} bytes", lambda: self.gl.buffer(data.tobytes()))
        return buffer

    def reserve_buffer(self, num_bytes: int) -> Any:
        """Zeroed shader storage buffer."""
        buffer = self._allocate(f"buffer of {num_bytes} bytes", lambda: self.gl.buffer(reserve=num_bytes))
        buffer.clear()
        return buffer

    def texture(self, width: int, height: int, components: int, dtype: str, data: bytes | None = None) -> Any:
        """2D texture without filtering; row 0 of the data is v = 0.

        Args:
            width: texels.
            height: texels.
            components: 1 to 4.
            dtype: moderngl data type, for example "f4" or "i4".
            data: texels row by row, or None.
        """
        texture = self._allocate(
            f"texture of {width} x {height}",
            lambda: self.gl.texture((width, height), components, data, dtype=dtype),
        )
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture

    def framebuffer(self, colours: list[Any], depth_size: tuple[int, int] | None = None) -> Any:
        """Frame buffer with colour textures and, when a size is given, a depth buffer."""

        def create() -> Any:
            depth = None if depth_size is None else self.gl.depth_renderbuffer(depth_size)
            return self.gl.framebuffer(colours, depth)

        return self._allocate("frame buffer", create)

    def leave_framebuffer(self) -> None:
        """Bind a spare 1x1 frame buffer. To be called before the one in use is released: moderngl would bind it again."""
        self._idle.use()

    def storage_barrier(self) -> None:
        """Make shader storage writes visible to what follows, reading back included."""
        self.gl.memory_barrier()
        self.check("compute shader")

    def _allocate(self, what: str, create: Any) -> Any:
        try:
            made = create()
        except moderngl.Error as error:
            raise GraphicsError(f"{what}: {error} on renderer {self.renderer!r}.") from error
        error_name = self.gl.error
        if error_name != "GL_NO_ERROR":
            made.release()
            raise GraphicsError(
                f"{what}: {error_name} on renderer {self.renderer!r}. It may be too large for the device."
            )
        return made

    def release(self) -> None:
        """Free the context and all that was made in it; calling it again does nothing."""
        if self._is_released:
            return
        context = self.gl
        self._is_released = True
        context.release()
        living = _living()
        living.remove(self)
        if living:
            living[-1]._context.__enter__()

    def __enter__(self) -> GlContext:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


def open_context() -> GlContext:
    """Open a headless context through EGL and make it current; no display, window or device node is needed.

    Raises:
        GraphicsError: the libraries are missing or OpenGL 4.3 is not offered; says what to install.
    """
    try:
        context = moderngl.create_context(require=_REQUIRED_VERSION, **_HEADLESS)
    # glcontext raises plain Exception.
    except Exception as error:
        raise GraphicsError(
            f"no headless OpenGL 4.3 context ({error}). On Debian: apt-get install libegl1 libgl1; "
            "or choose the CPU backend, which needs no OpenGL."
        ) from error
    opened = GlContext(context)
    _living().append(opened)
    return opened


def _living() -> list[GlContext]:
    if not hasattr(_LIVING, "contexts"):
        _LIVING.contexts = []
    contexts: list[GlContext] = _LIVING.contexts
    return contexts

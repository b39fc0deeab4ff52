from __future__ import annotations

import threading
from collections.abc import Iterator

import moderngl
import numpy as np
import pytest

from nearfield_server.errors import GraphicsError
from nearfield_server.gpu import context as context_module
from nearfield_server.gpu.context import GlContext, open_context

pytestmark = pytest.mark.gl


@pytest.fixture
def context() -> Iterator[GlContext]:
    with open_context() as opened:
        yield opened


def test_names_its_renderer_and_knows_software(context: GlContext) -> None:
    assert context.renderer
    assert context.is_software == any(name in context.renderer.lower() for name in ("llvmpipe", "softpipe"))
    context.check("nothing happened")


def test_buffers_hold_what_was_put_in(context: GlContext) -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    np.testing.assert_array_equal(
        np.frombuffer(context.storage_buffer(values).read(), np.float32), values.reshape(-1)
    )
    assert context.reserve_buffer(256).read() == bytes(256)


def test_allocations_that_the_driver_refuses_silently_raise(context: GlContext) -> None:
    with pytest.raises(GraphicsError, match="texture of 100000 x 8: GL_INVALID_VALUE on renderer"):
        context.texture(100000, 8, 4, "f4")
    context.texture(8, 8, 4, "f4")


def test_use_after_release_and_from_another_thread_is_refused() -> None:
    context = open_context()
    caught: list[Exception] = []

    def use() -> None:
        try:
            context.check("elsewhere")
        except GraphicsError as error:
            caught.append(error)

    thread = threading.Thread(target=use)
    thread.start()
    thread.join()
    assert "thread" in str(caught[0])
    context.release()
    context.release()
    with pytest.raises(GraphicsError, match="already released"):
        context.check("after release")


def test_contexts_nest_in_one_thread(context: GlContext) -> None:
    buffer = context.storage_buffer(np.array([7], dtype=np.int32))
    with open_context() as inner:
        inner.storage_buffer(np.array([8], dtype=np.int32))
    assert np.frombuffer(buffer.read(), np.int32)[0] == 7
    context.storage_buffer(np.array([9], dtype=np.int32))
    context.check("after the inner context")


def test_missing_libraries_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(**settings: object) -> None:
        raise Exception("libGL.so not loaded")

    monkeypatch.setattr(context_module.moderngl, "create_context", fail)
    with pytest.raises(GraphicsError, match=r"libGL\.so not loaded.*apt-get install libegl1 libgl1"):
        open_context()


def test_moderngl_errors_become_ours(context: GlContext) -> None:
    def refuse() -> None:
        raise moderngl.Error("no")

    with pytest.raises(GraphicsError, match="thing: no on renderer"):
        context._allocate("thing", refuse)

"""Shader programs from files, with `#include "name.glsl"` of shared chunks."""

from __future__ import annotations

import re
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

import moderngl

from nearfield_server.errors import GraphicsError
from nearfield_server.gpu.context import GlContext

_INCLUDE = re.compile(r'^\s*#include\s+"([A-Za-z0-9_.]+)"\s*$', re.MULTILINE)


def _folders() -> tuple[Traversable, ...]:
    """Where shaders are looked for: the server's own, then the chunks that it shares with the client."""
    return files("nearfield_server.gpu") / "shaders", files("nearfield_protocol") / "glsl"


def load_source(name: str) -> str:
    """Text of a shader with its includes resolved; each file is included once.

    Raises:
        GraphicsError: no such file.
    """
    return _resolve(name, set())


def _resolve(name: str, included: set[str]) -> str:
    included.add(name)
    for folder in _folders():
        file = folder / name
        if file.is_file():
            text = file.read_text(encoding="utf-8")
            break
    else:
        raise GraphicsError(f"shader {name!r}: no such file in the package.")

    def replace(match: re.Match[str]) -> str:
        return "" if match.group(1) in included else _resolve(match.group(1), included)

    return _INCLUDE.sub(replace, text)


def load_compute(context: GlContext, name: str) -> Any:
    """Compile a compute shader.

    Raises:
        GraphicsError: no such file, or the driver refuses it; names the file and holds the driver's log.
    """
    try:
        program = context.gl.compute_shader(load_source(name))
    except moderngl.Error as error:
        raise GraphicsError(f"shader {name}: {error} on renderer {context.renderer!r}.") from error
    context.check(f"shader {name}")
    return program


def load_program(context: GlContext, vertex: str, fragment: str) -> Any:
    """Compile and link a vertex and a fragment shader.

    Raises:
        GraphicsError: see `load_compute`.
    """
    try:
        program = context.gl.program(vertex_shader=load_source(vertex), fragment_shader=load_source(fragment))
    except moderngl.Error as error:
        raise GraphicsError(
            f"shaders {vertex}, {fragment}: {error} on renderer {context.renderer!r}."
        ) from error
    context.check(f"shaders {vertex}, {fragment}")
    return program

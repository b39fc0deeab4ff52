from __future__ import annotations

from pathlib import Path

import pytest

from nearfield_server.errors import GraphicsError
from nearfield_server.gpu import programs
from nearfield_server.gpu.context import open_context

pytestmark = pytest.mark.gl


@pytest.fixture
def shaders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(programs, "_folders", lambda: (tmp_path,))
    (tmp_path / "one.glsl").write_text('#include "two.glsl"\nfloat one() { return two() - 1.0; }\n')
    (tmp_path / "two.glsl").write_text('#include "one.glsl"\nfloat two() { return 2.0; }\n')
    return tmp_path


def test_includes_are_resolved_once_each(shaders: Path) -> None:
    (shaders / "a.comp").write_text('#include "one.glsl"\n  #include "two.glsl"\nvoid main() {}\n')
    source = programs.load_source("a.comp")
    assert source.count("float one()") == source.count("float two()") == 1
    assert source.index("two() {") < source.index("one() {")
    assert "#include" not in source


def test_missing_file_and_missing_include_are_named(shaders: Path) -> None:
    with pytest.raises(GraphicsError, match=r"'none\.comp': no such file"):
        programs.load_source("none.comp")
    (shaders / "a.comp").write_text('#include "none.glsl"\n')
    with pytest.raises(GraphicsError, match=r"'none\.glsl'"):
        programs.load_source("a.comp")


def test_compile_errors_name_the_file(shaders: Path) -> None:
    (shaders / "bad.comp").write_text(
        "#version 430\nlayout(local_size_x = 1) in;\nvoid main() { nonsense; }\n"
    )
    (shaders / "bad.vert").write_text("#version 430\nvoid main() { nonsense; }\n")
    (shaders / "bad.frag").write_text("#version 430\nvoid main() {}\n")
    with open_context() as context:
        with pytest.raises(GraphicsError, match=r"(?s)shader bad\.comp: .*nonsense"):
            programs.load_compute(context, "bad.comp")
        with pytest.raises(GraphicsError, match=r"shaders bad\.vert, bad\.frag: "):
            programs.load_program(context, "bad.vert", "bad.frag")

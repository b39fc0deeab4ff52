from __future__ import annotations

from pathlib import Path

import pytest

from nearfield_server.cache_root import cache_root


def test_folder_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NEARFIELD_CACHE_DIR", raising=False)
    assert cache_root() == tmp_path / "nearfield"
    monkeypatch.setenv("NEARFIELD_CACHE_DIR", str(tmp_path / "own"))
    assert cache_root() == tmp_path / "own"

from __future__ import annotations

from pathlib import Path

import pytest

from nearfield_server.errors import ConfigError
from nearfield_server.virtual_lab.backend import find_llvm


def test_newest_usable_llvm_wins(tmp_path: Path) -> None:
    for name in ("libLLVM-14.so.1", "libLLVM-16.so.1", "libLLVM.so.19.1", "libLLVM.so.18.1"):
        (tmp_path / name).touch()
    assert find_llvm((f"{tmp_path}/libLLVM*.so*",)).endswith("libLLVM.so.19.1")


def test_too_old_llvm_is_refused_with_the_package_to_install(tmp_path: Path) -> None:
    (tmp_path / "libLLVM-15.so.1").touch()
    with pytest.raises(ConfigError, match=r"found .*libLLVM-15\.so\.1.*apt-get install libllvm19"):
        find_llvm((f"{tmp_path}/libLLVM*.so*",))


def test_no_llvm_at_all(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="found none"):
        find_llvm((f"{tmp_path}/libLLVM*.so*",))

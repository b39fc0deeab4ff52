"""Loads Mitsuba 3 (optional extra `lab`) with an LLVM that works."""

from __future__ import annotations

import importlib
import os
import re
from dataclasses import dataclass
from glob import glob
from typing import Any

from nearfield_server.errors import ConfigError

# Dr.Jit aborts inside LLVM 14 and 15 ("Cannot select: fminimum"), so those must never be picked.
MIN_LLVM = 16
VARIANT = "llvm_ad_rgb"
LLVM_PATTERNS = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
)
LLVM_HELP = f"Install one (Debian: `apt-get install libllvm19`) or set DRJIT_LIBLLVM_PATH to a libLLVM of version {MIN_LLVM} or newer."


@dataclass(frozen=True, slots=True)
class Backend:
    """The two modules everything is traced with: `mi` is mitsuba, `dr` is drjit."""

    mi: Any
    dr: Any


def find_llvm(patterns: tuple[str, ...] = LLVM_PATTERNS) -> str:
    """Path of the newest libLLVM that Dr.Jit can use.

    Raises:
        ConfigError: no libLLVM of version 16 or newer is installed.
    """
    found: list[tuple[int, str]] = []
    for pattern in patterns:
        for path in glob(pattern):
            match = re.search(r"libLLVM(?:-(\d+)\.so|\.so\.(\d+)|-(\d+)\.dylib)", path)
            if match:
                found.append((int(next(group for group in match.groups() if group)), path))
    usable = sorted(item for item in found if item[0] >= MIN_LLVM)
    if not usable:
        seen = ", ".join(path for _, path in sorted(found)) or "none"
        raise ConfigError(
            f"virtual lab: no usable LLVM library. Expected version {MIN_LLVM} or newer, found {seen}. {LLVM_HELP}"
        )
    return usable[-1][1]


def load_backend() -> Backend:
    """Import Mitsuba in its vectorised variant.

    Raises:
        ConfigError: Mitsuba or a usable LLVM is not installed.
    """
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        os.environ["DRJIT_LIBLLVM_PATH"] = find_llvm()
    try:
        mi = importlib.import_module("mitsuba")
        dr = importlib.import_module("drjit")
    except ImportError as error:
        raise ConfigError(
            "virtual lab: Mitsuba is not installed. Install the extra: `pip install nearfield[lab]`."
        ) from error
    mi.set_variant(VARIANT)
    return Backend(mi, dr)

"""Where things are kept that can be made again."""

from __future__ import annotations

import os
from pathlib import Path


def cache_root() -> Path:
    """`$NEARFIELD_CACHE_DIR`, else `$XDG_CACHE_HOME/nearfield`, else `~/.cache/nearfield`."""
    chosen = os.environ.get("NEARFIELD_CACHE_DIR")
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "nearfield"

"""The heap of a process that takes and frees whole pictures many times a second."""

from __future__ import annotations

import ctypes
from typing import Final

# Parameters of mallopt, <malloc.h>; 32 MB is the most that glibc takes for the first.
_M_MMAP_THRESHOLD: Final = -3
_M_TRIM_THRESHOLD: Final = -1
_PICTURE_BYTES: Final = 32 << 20
_KEPT_BYTES: Final = 256 << 20


def keep_freed_memory() -> bool:
    """Let freed pictures stay with this process instead of going back to the kernel; false where the C library has no such setting.

    The kernel hands memory out in pages that it clears first. For a picture of 8 MB taken anew 40 times a second that was found to cost
    as much time as compressing it.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, _PICTURE_BYTES) and mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES))

"""Files that appear whole or not at all, whoever reads or dies meanwhile."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def whole_file(path: Path, *, is_durable: bool = False) -> Iterator[Path]:
    """Give a name beside `path` to write to; afterwards the file takes the place of `path`, in one step. On an error nothing is left of it.

    Args:
        path: of the file to make or to replace; its folder is made if it is not there.
        is_durable: the disk has it before it takes the place.

    Raises:
        OSError: the disk refuses; a file that was there before is untouched.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        yield partial
        if is_durable:
            descriptor = os.open(partial, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        os.replace(partial, path)
    except BaseException:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise

"""Files of a run, written whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from nearfield_server.errors import AssetError
from nearfield_server.whole_file import whole_file


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a file whole or not at all.

    Raises:
        AssetError: it cannot be written.
    """
    try:
        with whole_file(path) as partial:
            partial.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise AssetError(f"{path}: cannot be written ({error.strerror}); choose another --out") from error

"""Plain values as TOML text (the standard library only reads it)."""

from __future__ import annotations

import json
import math
import re
from typing import Any

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+\Z")


def toml_value(value: Any) -> str:
    """One value: text, numbers, booleans, lists and inline tables; `tomllib` gives it back equal.

    Raises:
        TypeError: TOML has nothing for it.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if math.isnan(value):
            return "nan"
        if math.isinf(value):
            return "inf" if value > 0 else "-inf"
        return repr(float(value))  # of numpy too
    if isinstance(value, str):
        # JSON and TOML escape alike, except for the delete character.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(entry) for entry in value) + "]"
    if isinstance(value, dict):
        pairs = (f"{toml_key(key)} = {toml_value(entry)}" for key, entry in value.items())
        return "{ " + ", ".join(pairs) + " }"
    raise TypeError(f"TOML has no {type(value).__name__}")


def toml_key(key: str) -> str:
    """A key, quoted where it must be."""
    return key if _BARE_KEY.match(key) else toml_value(key)


def toml_document(values: dict[str, Any]) -> str:
    """A document: plain values first, then tables and arrays of tables one level deep, everything deeper inline."""
    lines = [
        f"{toml_key(key)} = {toml_value(value)}" for key, value in values.items() if not _is_table(value)
    ]
    for key, value in values.items():
        if not _is_table(value):
            continue
        tables = value if isinstance(value, list) else [value]
        header = f"[[{toml_key(key)}]]" if isinstance(value, list) else f"[{toml_key(key)}]"
        for table in tables:
            lines += [
                "",
                header,
                *(f"{toml_key(name)} = {toml_value(entry)}" for name, entry in table.items()),
            ]
    return "\n".join(lines) + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and all(isinstance(entry, dict) for entry in value)
    )

"""Writes binary glTF (GLB): arrays are collected into one aligned binary chunk."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963


@dataclass(slots=True)
class GlbWriter:
    """Collects arrays into one binary chunk; the caller fills in meshes, materials and nodes of `document`."""

    document: dict[str, Any] = field(
        default_factory=lambda: {"asset": {"version": "2.0", "generator": "nearfield"}}
    )
    _binary: bytearray = field(default_factory=bytearray)

    def add_buffer_view(self, data: bytes, target: int | None = None) -> int:
        """Append bytes, aligned to 4; returns the index of their buffer view."""
        self._binary.extend(b"\0" * (-len(self._binary) % 4))
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._binary), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self._binary.extend(data)
        views = self.document.setdefault("bufferViews", [])
        views.append(view)
        return len(views) - 1

    def add_vectors(self, values: NDArray[np.floating]) -> int:
        """Append an (n, 3) float32 vertex attribute with its bounds; returns the index of its accessor."""
        data = np.ascontiguousarray(values, dtype="<f4")
        return self._add_accessor(
            data,
            _ARRAY_BUFFER,
            5126,
            "VEC3",
            {"min": data.min(axis=0).tolist(), "max": data.max(axis=0).tolist()},
        )

    def add_indices(self, faces: NDArray[np.integer]) -> int:
        """Append triangles (n, 3) as uint32 indices; returns the index of their accessor."""
        return self._add_accessor(
            np.ascontiguousarray(faces, dtype="<u4").reshape(-1), _ELEMENT_ARRAY_BUFFER, 5125, "SCALAR", {}
        )

    def _add_accessor(
        self, data: NDArray[Any], target: int, component: int, kind: str, bounds: dict[str, Any]
    ) -> int:
        view = self.add_buffer_view(data.tobytes(), target)
        accessors = self.document.setdefault("accessors", [])
        accessors.append(
            {"bufferView": view, "componentType": component, "count": len(data), "type": kind, **bounds}
        )
        return len(accessors) - 1

    def to_bytes(self) -> bytes:
        """The whole file."""
        binary = bytes(self._binary) + b"\0" * (-len(self._binary) % 4)
        self.document["buffers"] = [{"byteLength": len(binary)}]
        text = json.dumps(self.document, separators=(",", ":"), allow_nan=False).encode("utf-8")
        text += b" " * (-len(text) % 4)
        header = struct.pack("<III", _MAGIC, 2, 12 + 8 + len(text) + 8 + len(binary))
        return (
            header
            + struct.pack("<II", len(text), _JSON)
            + text
            + struct.pack("<II", len(binary), _BIN)
            + binary
        )

"""The GLB container: its JSON, its one binary chunk, and typed views of accessors, every length checked."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import AssetError

MAX_FILE_BYTES = 512 << 20
_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_COMPONENT_TYPES = {
    5120: np.int8,
    5121: np.uint8,
    5122: np.int16,
    5123: np.uint16,
    5125: np.uint32,
    5126: np.float32,
}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


@dataclass(frozen=True, slots=True)
class Glb:
    """A parsed GLB file.

    Attributes:
        path: for messages. document: the JSON chunk. binary: the binary chunk, empty if there is none.
    """

    path: Path
    document: dict[str, Any]
    binary: bytes

    def item(self, kind: str, index: object) -> dict[str, Any]:
        """Element `index` of the top-level array `kind`.

        Raises:
            AssetError: there is none.
        """
        items = self.document.get(kind, [])
        if not isinstance(items, list) or not isinstance(index, int) or not 0 <= index < len(items):
            raise AssetError(f"{self.path}: {kind}[{index!r}] does not exist; export the model again")
        item = items[index]
        if not isinstance(item, dict):
            raise AssetError(f"{self.path}: {kind}[{index}] is not an object; export the model again")
        return item

    def buffer_view(self, index: object) -> bytes:
        """Bytes of a buffer view.

        Raises:
            AssetError: it lies outside the binary chunk, or in another file.
        """
        view = self.item("bufferViews", index)
        start, length = view.get("byteOffset", 0), view.get("byteLength")
        if view.get("buffer") != 0 or "uri" in self.item("buffers", 0):
            raise AssetError(
                f"{self.path}: bufferViews[{index}] is not in the file's own binary chunk; export as one .glb"
            )
        if (
            not isinstance(start, int)
            or not isinstance(length, int)
            or start < 0
            or length < 0
            or start + length > len(self.binary)
        ):
            raise AssetError(
                f"{self.path}: bufferViews[{index}] asks for bytes {start}+{length}, the binary chunk has {len(self.binary)}; "
                f"the file is cut short"
            )
        return self.binary[start : start + length]

    def accessor(self, index: object, kind: str) -> NDArray[Any]:
        """Values of an accessor of type `kind`: (count,) for SCALAR, else (count, components), in the stored number type.

        Raises:
            AssetError: wrong type, sparse, compressed, or longer than its data.
        """
        accessor = self.item("accessors", index)
        dtype, count = _COMPONENT_TYPES.get(accessor.get("componentType", 0)), accessor.get("count")
        if (
            accessor.get("type") != kind
            or dtype is None
            or "sparse" in accessor
            or "bufferView" not in accessor
        ):
            raise AssetError(
                f"{self.path}: accessors[{index}] should be a plain {kind}, found type {accessor.get('type')!r}; export without compression"
            )
        data = self.buffer_view(accessor["bufferView"])
        width = _COMPONENTS[kind]
        item_bytes = width * np.dtype(dtype).itemsize
        stride = self.item("bufferViews", accessor["bufferView"]).get("byteStride") or item_bytes
        offset = accessor.get("byteOffset", 0)
        if (
            not (isinstance(count, int) and isinstance(offset, int) and isinstance(stride, int))
            or min(count - 1, offset, stride - item_bytes) < 0
            or offset + stride * (count - 1) + item_bytes > len(data)
        ):
            raise AssetError(
                f"{self.path}: accessors[{index}] does not fit into its buffer view of {len(data)} bytes; the file is broken"
            )
        rows = np.ndarray((count, width), dtype, data, offset, (stride, np.dtype(dtype).itemsize))
        values = np.ascontiguousarray(rows)
        return values[:, 0] if kind == "SCALAR" else values


def read_glb(path: str | Path) -> Glb:
    """Read and check a GLB file.

    Raises:
        AssetError: no such file, no GLB 2.0, too large, or cut short.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise AssetError(
                f"{path}: {path.stat().st_size} bytes, at most {MAX_FILE_BYTES} are read; simplify the model"
            )
        data = path.read_bytes()
    except OSError as error:
        raise AssetError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    if len(data) < 20 or struct.unpack_from("<II", data) != (_MAGIC, 2):
        raise AssetError(
            f"{path}: not a GLB 2.0 file (expected the bytes 'glTF' and version 2); export as binary glTF"
        )
    total = struct.unpack_from("<I", data, 8)[0]
    if total > len(data):
        raise AssetError(f"{path}: cut short, {len(data)} of {total} bytes; copy or export it again")
    chunks: dict[int, bytes] = {}
    position = 12
    while position + 8 <= total:
        length, kind = struct.unpack_from("<II", data, position)
        if position + 8 + length > total:
            raise AssetError(
                f"{path}: a chunk of {length} bytes runs past the end of the file; copy or export it again"
            )
        chunks.setdefault(kind, data[position + 8 : position + 8 + length])
        position += 8 + length
    try:
        document = json.loads(chunks.get(_JSON, b"").decode("utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise AssetError(f"{path}: its JSON chunk cannot be parsed ({error}); export it again") from error
    if not isinstance(document, dict):
        raise AssetError(f"{path}: its JSON chunk is not an object; export it again")
    return Glb(path, document, chunks.get(_BIN, b""))


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
            ARRAY_BUFFER,
            5126,
            "VEC3",
            {"min": data.min(axis=0).tolist(), "max": data.max(axis=0).tolist()},
        )

    def add_indices(self, faces: NDArray[np.integer]) -> int:
        """Append triangles (n, 3) as uint32 indices; returns the index of their accessor."""
        return self._add_accessor(
            np.ascontiguousarray(faces, dtype="<u4").reshape(-1), ELEMENT_ARRAY_BUFFER, 5125, "SCALAR", {}
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

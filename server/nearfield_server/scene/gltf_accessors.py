"""Typed arrays out of the binary chunk of a GLB file, every range checked before it is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import AssetError

_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Buffers:
    """Accessors of one GLB document.

    Args:
        path: file, for messages.
        document: glTF JSON.
        binary: binary chunk (buffer 0); other buffers are refused.
    """

    def __init__(self, path: Path, document: dict[str, Any], binary: bytes) -> None:
        self._path = path
        self._document = document
        self._binary = binary

    def _fail(self, where: str, expected: str, found: object) -> AssetError:
        return AssetError(f"{self._path}:{where}: expected {expected}, found {found}. Export the file again.")

    def _array(self, accessor_index: int, where: str) -> tuple[NDArray[Any], bool]:
        """(count, width) array in the stored type, and whether integers are normalised."""
        accessor = self._document["accessors"][accessor_index]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise self._fail(where, "a plain accessor", "a sparse or empty one")
        view = self._document["bufferViews"][accessor["bufferView"]]
        buffer = self._document["buffers"][view.get("buffer", 0)]
        if view.get("buffer", 0) != 0 or "uri" in buffer:
            raise self._fail(where, "data inside the GLB file", f"uri {str(buffer.get('uri'))[:40]!r}")
        if accessor["componentType"] not in _DTYPES or accessor["type"] not in _WIDTHS:
            raise self._fail(
                where, "scalars or vectors", f"{accessor['type']} of type {accessor['componentType']}"
            )
        dtype, width, count = (
            np.dtype(_DTYPES[accessor["componentType"]]),
            _WIDTHS[accessor["type"]],
            accessor["count"],
        )
        stride = view.get("byteStride", dtype.itemsize * width)
        view_start, inner = view.get("byteOffset", 0), accessor.get("byteOffset", 0)
        numbers = (count, stride, view_start, inner, view["byteLength"])
        if (
            any(isinstance(n, bool) or not isinstance(n, int) or n < 0 for n in numbers)
            or stride < dtype.itemsize * width
        ):
            raise self._fail(where, "sizes and offsets >= 0", numbers)
        needed = inner + (stride * (count - 1) + dtype.itemsize * width if count else 0)
        if needed > view["byteLength"] or view_start + needed > len(self._binary):
            raise self._fail(
                where, f"{needed} bytes", f"{min(view['byteLength'], len(self._binary) - view_start)}"
            )
        if not count:
            return np.zeros((0, width), dtype), False
        array: NDArray[Any] = np.ndarray(
            (count, width), dtype, self._binary, offset=view_start + inner, strides=(stride, dtype.itemsize)
        )
        return array, bool(accessor.get("normalized", False))

    def floats(self, accessor_index: int, width: int, where: str) -> NDArray[np.float64]:
        """(count, width) float64; normalised integers are converted.

        Raises:
            AssetError: wrong width, out of range, external, or values that are not finite.
        """
        array, normalised = self._array(accessor_index, where)
        if array.shape[1] != width:
            raise self._fail(where, f"{width} components", array.shape[1])
        values = array.astype(np.float64)
        if normalised and array.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(array.dtype).max, -1.0)
        if not np.isfinite(values).all():
            raise self._fail(where, "finite numbers", "NaN or infinity")
        return values

    def indices(self, accessor_index: int, num_vertices: int, where: str) -> NDArray[np.int64]:
        """(count,) int64 vertex indices.

        Raises:
            AssetError: not unsigned integers, or an index beyond the vertices.
        """
        array, _ = self._array(accessor_index, where)
        if array.dtype.kind != "u" or array.shape[1] != 1:
            raise self._fail(where, "unsigned integers", array.dtype)
        values = array[:, 0].astype(np.int64)
        if values.size and values.max() >= num_vertices:
            raise self._fail(where, f"indices below {num_vertices}", values.max())
        return values

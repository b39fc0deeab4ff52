"""Checked access to the fields of a JSON file: every error names the file and the key."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.errors import CalibrationError
from nearfield_calibration.fisheye import check_intrinsics
from nearfield_calibration.models import FisheyeIntrinsics, PinholeIntrinsics
from nearfield_server.errors import AssetError

MAX_JSON_BYTES = 64 * 1024 * 1024


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        AssetError: missing, too large, not JSON, or not an object.
    """
    if not path.is_file():
        raise AssetError(f"{path}: no such file.")
    if path.stat().st_size > MAX_JSON_BYTES:
        raise AssetError(f"{path}: expected at most {MAX_JSON_BYTES} bytes, found {path.stat().st_size}.")
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise AssetError(f"{path}: not valid JSON ({error}).") from error
    if not isinstance(value, dict):
        raise AssetError(f"{path}: expected a JSON object at the top, found {type(value).__name__}.")
    return value


def check_transform(matrix: NDArray[np.float64]) -> str | None:
    """Why a (4, 4) matrix is no rotation and translation, or None if it is one (to 1e-4, the precision of typed files)."""
    if matrix.shape != (4, 4):
        return f"shape {matrix.shape}"
    if not np.isfinite(matrix).all():
        return "values that are not finite"
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9:
        return f"last row {matrix[3].tolist()}"
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4:
        return "axes that are not perpendicular unit vectors"
    if np.linalg.det(rotation) < 0:
        return "a mirrored frame"
    return None


class Fields:
    """One JSON object with the path of keys that led to it."""

    def __init__(self, values: dict[str, Any], file: Path, where: str = "") -> None:
        self._values = values
        self._file = file
        self._where = where

    def error(self, key: str, expected: str, found: str) -> AssetError:
        """An error that names the file and the full key."""
        return AssetError(f"{self._file}:{self._where}{key}: expected {expected}, found {found}.")

    def has(self, key: str) -> bool:
        """Whether the key is there and not null."""
        return self._values.get(key) is not None

    def holds(self, key: str, kind: type) -> bool:
        """Whether the key is there with a value of this kind that is not empty."""
        return isinstance(self._values.get(key), kind) and bool(self._values[key])

    def names(self) -> Iterator[str]:
        """Keys of the object."""
        return iter(self._values)

    def _get(self, key: str, expected: str) -> Any:
        if key not in self._values:
            raise self.error(key, expected, "nothing")
        return self._values[key]

    def scalar(self, key: str) -> str | int:
        """A text or an integer (identifiers are either)."""
        value = self._get(key, "a text or an integer")
        if isinstance(value, bool) or not isinstance(value, (str, int)):
            raise self.error(key, "a text or an integer", repr(value)[:60])
        return value

    def text(self, key: str) -> str:
        """A text that is not empty."""
        value = self._get(key, "a text")
        if not isinstance(value, str) or not value:
            raise self.error(key, "a text", repr(value)[:60])
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts."""
        value = self._get(key, "a list of texts")
        if not isinstance(value, list) or not all(isinstance(item, str) and item for item in value):
            raise self.error(key, "a list of texts", repr(value)[:60])
        return tuple(value)

    def number(self, key: str, *, above: float = -math.inf) -> float:
        """A finite number greater than `above`."""
        value = self._get(key, "a number")
        if (
            isinstance(value, bool)
            or not isinstance(value, (int, float))
            or not math.isfinite(value)
            or value <= above
        ):
            raise self.error(key, f"a finite number > {above}", repr(value)[:60])
        return float(value)

    def size(self, key: str) -> int:
        """An integer from 1 to 16384."""
        value = self._get(key, "an integer")
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 16384:
            raise self.error(key, "an integer from 1 to 16384", repr(value)[:60])
        return value

    def _array(self, key: str, expected: str) -> NDArray[np.float64]:
        value = self._get(key, expected)
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise self.error(key, expected, repr(value)[:60]) from None
        if not np.isfinite(array).all():
            raise self.error(key, expected, "values that are not finite")
        return array

    def vector(
        self, key: str, *, at_least: float = -math.inf, at_most: float = math.inf
    ) -> tuple[float, float, float]:
        """Three finite numbers in [at_least, at_most]."""
        expected = f"three numbers in [{at_least}, {at_most}]"
        array = self._array(key, expected)
        if array.shape != (3,) or (array < at_least).any() or (array > at_most).any():
            raise self.error(key, expected, repr(self._values[key])[:60])
        return float(array[0]), float(array[1]), float(array[2])

    def matrix(self, key: str, *, columns: int) -> NDArray[np.float64]:
        """(rows, columns) float64 with at least one row."""
        expected = f"rows of {columns} numbers"
        array = self._array(key, expected)
        if array.ndim != 2 or array.shape[1] != columns or not array.shape[0]:
            raise self.error(key, expected, f"shape {array.shape}")
        return array

    def transform(self, key: str) -> NDArray[np.float64]:
        """(4, 4) float64 rotation and translation."""
        expected = "a 4 x 4 rotation and translation"
        array = self._array(key, expected)
        wrong = check_transform(array)
        if wrong is not None:
            raise self.error(key, expected, wrong)
        return array

    def file(self, key: str) -> Path:
        """An existing file inside the folder of the JSON file."""
        return self._existing(key, self.text(key))

    def files(self, key: str, count: int) -> tuple[Path, ...]:
        """`count` existing files inside the folder of the JSON file."""
        names = self.texts(key)
        if len(names) != count:
            raise self.error(key, f"{count} files (one per light)", f"{len(names)}")
        return tuple(self._existing(f"{key}[{index}]", name) for index, name in enumerate(names))

    def _existing(self, key: str, name: str) -> Path:
        folder = self._file.parent
        path = folder / name
        if not path.resolve().is_relative_to(folder.resolve()):
            raise self.error(key, "a file inside the folder", repr(name))
        if not path.is_file():
            raise self.error(key, "an existing file", repr(name))
        return path

    def sub(self, key: str) -> Fields:
        """A nested object."""
        value = self._get(key, "an object")
        if not isinstance(value, dict):
            raise self.error(key, "an object", repr(value)[:60])
        return Fields(value, self._file, f"{self._where}{key}.")

    def items(self, key: str, *, required: bool = True) -> list[Fields]:
        """A list of objects; empty when absent and not required."""
        if not required and not self.has(key):
            return []
        value = self._get(key, "a list of objects")
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(key, "a list of objects", repr(value)[:60])
        return [Fields(item, self._file, f"{self._where}{key}[{index}].") for index, item in enumerate(value)]

    def pinhole(self) -> PinholeIntrinsics:
        """Pinhole lens from width, height, fx, fy, cx, cy."""
        return PinholeIntrinsics(
            width=self.size("width"),
            height=self.size("height"),
            fx=self.number("fx", above=0.0),
            fy=self.number("fy", above=0.0),
            cx=self.number("cx"),
            cy=self.number("cy"),
        )

    def fisheye(self) -> FisheyeIntrinsics:
        """Fish-eye lens from width, height, fx, fy, cx, cy, k (absent = equidistant) and theta_max_deg."""
        k = self._array("k", "four numbers") if self.has("k") else np.zeros(4)
        if k.shape != (4,):
            raise self.error("k", "four numbers", repr(self._values["k"])[:60])
        intrinsics = FisheyeIntrinsics(
            width=self.size("width"),
            height=self.size("height"),
            fx=self.number("fx", above=0.0),
            fy=self.number("fy", above=0.0),
            cx=self.number("cx"),
            cy=self.number("cy"),
            k=(float(k[0]), float(k[1]), float(k[2]), float(k[3])),
            theta_max=math.radians(self.number("theta_max_deg", above=0.0)),
        )
        try:
            check_intrinsics(intrinsics)
        except CalibrationError as error:
            raise self.error("k", "a usable lens", str(error)) from error
        return intrinsics

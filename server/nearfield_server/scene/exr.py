"""OpenEXR pictures in and out, with the header checked before any pixel is allocated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from nearfield_server.errors import AssetError

# Limits of what is read; far above any camera, far below what exhausts memory.
MAX_SIDE = 16384
MAX_PIXELS = 64 * 1024 * 1024
_COMPRESSIONS = {
    "none": OpenEXR.NO_COMPRESSION,
    "zip": OpenEXR.ZIP_COMPRESSION,
    "zips": OpenEXR.ZIPS_COMPRESSION,
    "piz": OpenEXR.PIZ_COMPRESSION,
    "rle": OpenEXR.RLE_COMPRESSION,
}


def read_size(path: str | Path) -> tuple[int, int]:
    """(height, width) of an EXR file from its header alone.

    Raises:
        AssetError: missing, not an EXR file, or larger than the limits.
    """
    header = _read_header(Path(path))
    return _size(header, Path(path))


def read_exr(path: str | Path, *, max_pixels: int = MAX_PIXELS) -> NDArray[np.float32]:
    """Read a single-part RGB or RGBA scan-line or tiled picture.

    Args:
        path: file.
        max_pixels: refuse larger pictures before reading pixels.

    Returns:
        (H, W, 3) float32, or (H, W, 4) when the file has an alpha channel; row 0 on top, values as stored
        (NaN and infinity included).

    Raises:
        AssetError: missing, truncated, corrupt, too large, or without R, G and B; names the file and the reason.
    """
    path = Path(path)
    height, width = _size(_read_header(path), path, max_pixels)
    try:
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
    except (RuntimeError, ValueError) as error:
        raise AssetError(
            f"{path}: pixels cannot be read, the file is truncated or corrupt ({error}). Copy it again."
        ) from error
    names = ("R", "G", "B", "A") if "A" in channels else ("R", "G", "B")
    picture = np.empty((height, width, len(names)), dtype=np.float32)
    for position, name in enumerate(names):
        pixels = channels[name].pixels
        if pixels is None or pixels.shape != (height, width):
            found = None if pixels is None else pixels.shape
            raise AssetError(
                f"{path}: channel {name}: expected {(height, width)} pixels, found {found}. Export it again."
            )
        picture[..., position] = pixels
    return picture


def write_exr(path: str | Path, pixels: NDArray[Any], *, half: bool = True, compression: str = "zip") -> None:
    """Write a picture.

    Args:
        path: file to create or replace.
        pixels: (H, W, 3) or (H, W, 4), row 0 on top.
        half: store 16-bit floats, else 32-bit floats.
        compression: "none", "zip", "zips", "piz" or "rle"; all lossless.

    Raises:
        AssetError: the shape is wrong, or the file cannot be written.
    """
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or 0 in pixels.shape:
        raise AssetError(f"{path}: expected pixels of shape (height, width, 3 or 4), found {pixels.shape}.")
    if compression not in _COMPRESSIONS:
        raise AssetError(
            f"{path}: compression: expected one of {sorted(_COMPRESSIONS)}, found {compression!r}."
        )
    data = np.ascontiguousarray(pixels, dtype=np.float16 if half else np.float32)
    header = {"compression": _COMPRESSIONS[compression], "type": OpenEXR.scanlineimage}
    name = "RGBA" if data.shape[2] == 4 else "RGB"
    try:
        OpenEXR.File(header, {name: data}).write(str(path))
    except RuntimeError as error:
        raise AssetError(
            f"{path}: cannot be written ({error}). Check the folder and the free space."
        ) from error


def _read_header(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise AssetError(f"{path}: no such file.")
    with path.open("rb") as stream:
        magic = stream.read(4)
    if magic != b"\x76\x2f\x31\x01":
        raise AssetError(
            f"{path}: not an OpenEXR file (expected magic 762f3101, found {magic.hex() or 'an empty file'})."
        )
    try:
        file = OpenEXR.File(str(path), header_only=True)
        parts, header = len(file.parts), dict(file.header())
    except (RuntimeError, ValueError) as error:
        raise AssetError(f"{path}: header cannot be read ({error}). Copy the file again.") from error
    if parts != 1:
        raise AssetError(f"{path}: expected one part, found {parts}. Export a single-part picture.")
    if header.get("type") not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
        raise AssetError(
            f"{path}: expected a flat picture, found type {header.get('type')}. Export without deep data."
        )
    return header


def _size(header: dict[str, Any], path: Path, max_pixels: int = MAX_PIXELS) -> tuple[int, int]:
    low, high = (np.asarray(corner, dtype=np.int64) for corner in header["dataWindow"])
    width, height = (int(extent) for extent in high - low + 1)
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE and width * height <= max_pixels):
        raise AssetError(
            f"{path}: data window of {width} x {height} pixels; expected at most {MAX_SIDE} per side and {max_pixels} in all."
        )
    display_low, display_high = (np.asarray(corner, dtype=np.int64) for corner in header["displayWindow"])
    if not (np.array_equal(low, display_low) and np.array_equal(high, display_high)):
        raise AssetError(
            f"{path}: data window and display window differ. Export the whole picture without cropping."
        )
    channels = {channel.name: channel for channel in header["channels"]}
    missing = [name for name in "RGB" if name not in channels]
    if missing:
        raise AssetError(f"{path}: expected channels R, G, B, found {sorted(channels)}.")
    sampled = [name for name, channel in channels.items() if (channel.xSampling, channel.ySampling) != (1, 1)]
    if sampled:
        raise AssetError(
            f"{path}: channels {sampled} are subsampled; expected full resolution. Export as RGB, not YC."
        )
    return height, width

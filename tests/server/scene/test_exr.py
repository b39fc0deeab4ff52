from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from nearfield_server.errors import AssetError
from nearfield_server.scene.exr import read_exr, read_size, write_exr


def picture(channels: int = 3, height: int = 37, width: int = 53) -> np.ndarray:
    values = np.random.default_rng(3).uniform(0, 40, (height, width, channels)).astype(np.float16)
    values[0, 0] = 65504
    return values


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("compression", ["none", "zip", "piz"])
def test_half_pictures_come_back_bit_for_bit(tmp_path: Path, channels: int, compression: str) -> None:
    values = picture(channels)
    write_exr(tmp_path / "a.exr", values, compression=compression)
    assert read_size(tmp_path / "a.exr") == (37, 53)
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr"), values.astype(np.float32))


def test_float_pictures_keep_values_beyond_half(tmp_path: Path) -> None:
    values = np.full((4, 5, 3), 1e6, dtype=np.float32)
    values[1, 2] = [np.inf, np.nan, 1e-20]
    write_exr(tmp_path / "a.exr", values, half=False)
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr"), values)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.05, 0.5, 0.98])
def test_truncated_file_is_refused_by_name(tmp_path: Path, share: float) -> None:
    write_exr(tmp_path / "a.exr", picture(3, 300, 300))
    data = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "b.exr").write_bytes(data[: int(len(data) * share)])
    with pytest.raises(AssetError, match=r"b\.exr: "):
        read_exr(tmp_path / "b.exr")


def test_corrupt_pixels_are_refused(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", picture(3, 300, 300))
    data = bytearray((tmp_path / "a.exr").read_bytes())
    half = len(data) // 2
    data[half : half + 4000] = bytes((value * 7 + 13) % 256 for value in data[half : half + 4000])
    (tmp_path / "b.exr").write_bytes(data)
    with pytest.raises(AssetError, match="truncated or corrupt"):
        read_exr(tmp_path / "b.exr")


def test_size_limit_holds_before_pixels_are_read(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", picture())
    with pytest.raises(AssetError, match="53 x 37 pixels; expected at most"):
        read_exr(tmp_path / "a.exr", max_pixels=1000)


def test_huge_data_window_is_refused_from_the_header(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", picture())
    data = (tmp_path / "a.exr").read_bytes()
    window = np.array([0, 0, 52, 36], dtype="<i4").tobytes()
    assert data.count(window) == 2  # data window and display window
    huge = np.array([0, 0, 2**30, 2**30], dtype="<i4").tobytes()
    (tmp_path / "b.exr").write_bytes(data.replace(window, huge))
    with pytest.raises(AssetError, match=r"b\.exr"):
        read_exr(tmp_path / "b.exr")


def test_other_files_are_refused_with_the_reason(tmp_path: Path) -> None:
    (tmp_path / "a.exr").write_bytes(b"\x89PNG and more")
    with pytest.raises(AssetError, match="not an OpenEXR file"):
        read_exr(tmp_path / "a.exr")
    with pytest.raises(AssetError, match="no such file"):
        read_exr(tmp_path / "none.exr")
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": np.zeros((4, 4), np.float32)}).write(
        str(tmp_path / "z.exr")
    )
    with pytest.raises(AssetError, match=r"expected channels R, G, B, found \['Z'\]"):
        read_exr(tmp_path / "z.exr")


def test_cropped_window_is_refused(tmp_path: Path) -> None:
    header = {
        "type": OpenEXR.scanlineimage,
        "displayWindow": (np.array([0, 0], np.int32), np.array([99, 99], np.int32)),
        "dataWindow": (np.array([0, 0], np.int32), np.array([52, 36], np.int32)),
    }
    OpenEXR.File(header, {"RGB": picture()}).write(str(tmp_path / "a.exr"))
    with pytest.raises(AssetError, match="data window and display window differ"):
        read_exr(tmp_path / "a.exr")


def test_wrong_shapes_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="expected pixels of shape"):
        write_exr(tmp_path / "a.exr", np.zeros((4, 4)))
    with pytest.raises(AssetError, match="compression"):
        write_exr(tmp_path / "a.exr", np.zeros((4, 4, 3)), compression="dwaa")

"""Golden vectors: decode, compare with the JSON, encode again byte for byte. The TypeScript codec does the same with the same files."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from nearfield_protocol import codec

PROTOCOL = Path(__file__).resolve().parents[2] / "protocol"
NAMES = sorted(path.stem for path in (PROTOCOL / "vectors").glob("*.bin"))


def numbers(texts: list[str], dtype: type = np.float32) -> np.ndarray:
    return np.array([float(text) for text in texts], np.float64).astype(dtype)


def same_bits(found: object, texts: list[str] | str) -> None:
    """Equal including the sign of zero; NaN equals NaN."""
    values = np.asarray(found, np.float64).reshape(-1)
    expected = np.array([float(text) for text in ([texts] if isinstance(texts, str) else texts)])
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(
        np.signbit(values[~np.isnan(values)]), np.signbit(expected[~np.isnan(expected)])
    )


def check_light_packet(data: bytes, value: dict) -> bytes:
    packet = codec.decode_light_packet(data)
    assert packet.timestamp_ns == int(value["timestamp_ns"])
    assert (packet.sequence, packet.room_revision) == (int(value["sequence"]), int(value["room_revision"]))
    assert len(packet.vals) == len(value["vals"])
    for val, expected in zip(packet.vals, value["vals"], strict=True):
        for name in codec.VAL_DTYPE.names:
            same_bits(val[name], expected[name])
    for sh, texts in zip(packet.object_sh, value["object_sh"], strict=True):
        same_bits(sh, texts)
    assert [str(int(revision)) for revision in packet.object_revisions] == value["object_revisions"]
    same_bits(packet.bounds_min, value["bounds_min"])
    same_bits(packet.bounds_size, value["bounds_size"])
    return codec.encode_light_packet(packet, codec.Encoding[value["encoding"]])


def check_atlas_tiles(data: bytes, value: dict) -> bytes:
    tiles = codec.decode_atlas_tiles(data)
    assert (tiles.width, tiles.height) == (int(value["width"]), int(value["height"]))
    same_bits(tiles.positions, value["positions"])
    assert int(tiles.texels.astype(np.uint64).sum()) == int(value["texel_sum"])
    for tile, texts in zip(tiles.texels, value["first_row_radiance"], strict=True):
        same_bits(codec.decode_radiance(tile[0]), texts)
    return codec.encode_atlas_tiles(tiles)


def check_control_state(data: bytes, value: dict) -> bytes:
    state = codec.decode_control_state(data)
    assert state.revision == int(value["revision"])
    same_bits(state.light_weights, value["light_weights"])
    for pose, expected in zip(state.object_poses, value["object_poses"], strict=True):
        assert pose.pose_revision == int(expected["pose_revision"])
        same_bits(pose.position, expected["position"])
        same_bits(pose.quaternion, expected["quaternion"])
    return codec.encode_control_state(state)


def check_status(data: bytes, value: dict) -> bytes:
    status = codec.decode_status(data)
    assert status.server_time_ns == int(value["server_time_ns"])
    assert status.is_stale == bool(int(value["is_stale"]))
    same_bits(status.light_age, value["light_age"])
    same_bits(status.camera_ages, value["camera_ages"])
    return codec.encode_status(status)


def check_client_message(data: bytes, value: dict) -> bytes:
    message = codec.decode_client_message(data)
    for name, texts in value.items():
        same_bits(getattr(message, name), texts)
    return codec.encode_client_message(message)


CHECKS = {
    "light_packet": check_light_packet,
    "atlas_tiles": check_atlas_tiles,
    "control_state": check_control_state,
    "status": check_status,
    "client_message": check_client_message,
}


def test_vectors_exist_for_every_message() -> None:
    messages = {json.loads((PROTOCOL / "vectors" / f"{name}.json").read_text())["message"] for name in NAMES}
    assert messages == set(CHECKS)


@pytest.mark.parametrize("name", NAMES)
def test_vector(name: str) -> None:
    data = (PROTOCOL / "vectors" / f"{name}.bin").read_bytes()
    described = json.loads((PROTOCOL / "vectors" / f"{name}.json").read_text())
    assert CHECKS[described["message"]](data, described["value"]) == data


@pytest.mark.parametrize("script", ["generate.py", "make_vectors.py"])
def test_generated_files_are_fresh(script: str) -> None:
    result = subprocess.run(
        [sys.executable, PROTOCOL / script, "--check"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr


def test_generator_refuses_a_field_that_is_not_aligned() -> None:
    parse_records = runpy.run_path(str(PROTOCOL / "generate.py"))["parse_records"]
    fields = [
        {"name": "flag", "type": "u1", "unit": "", "doc": ""},
        {"name": "radiance", "type": "f4", "unit": "", "doc": ""},
    ]
    with pytest.raises(ValueError, match=r"bad\.radiance at byte 1 is not aligned"):
        parse_records({"records": [{"name": "bad", "doc": "", "fields": fields}]})


def test_sizes_promised_by_the_paper() -> None:
    """Rohmer et al. 2014, Section 5: 32 bytes per VAL and 108 per object; half of it compact, whatever the header costs."""
    sizes = {}
    for name in ("light_empty", "light_typical", "light_full"):
        for encoding in ("plain", "compact"):
            sizes[name, encoding] = len((PROTOCOL / "vectors" / f"{name}_{encoding}.bin").read_bytes())
    plain, compact = sizes["light_empty", "plain"], sizes["light_empty", "compact"]
    assert sizes["light_full", "plain"] - plain == 64 * 32 + 10 * (108 + 4)
    assert sizes["light_full", "compact"] - compact == 64 * 16 + 10 * (54 + 4)
    assert sizes["light_typical", "compact"] - compact == 16 * 16 + 54 + 2 + 4

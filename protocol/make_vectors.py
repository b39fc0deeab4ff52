"""Write the golden vectors: vectors/<name>.bin and the same values as vectors/<name>.json.

python protocol/make_vectors.py           write
python protocol/make_vectors.py --check   fail (exit 1) if a file is missing, out of date or unexpected

Numbers in the JSON are strings ("NaN", "-0.0", "Infinity" and 64 bit integers survive every JSON reader). Both languages decode each .bin,
compare it with the .json and encode it again byte for byte.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from nearfield_protocol import codec

FOLDER = Path(__file__).resolve().parent / "vectors"


def number(value: float | int) -> str:
    """A number as every JSON reader of ours understands it."""
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    value = float(value)
    if math.isnan(value):
        return "NaN"
    if math.isinf(value):
        return "Infinity" if value > 0 else "-Infinity"
    return repr(value)


def numbers(values: Any) -> list[str]:
    """A flat list."""
    return [number(value) for value in np.asarray(values).reshape(-1)]


def random_packet(num_vals: int, num_objects: int, seed: int) -> codec.LightPacket:
    """A packet whose numbers span many powers of ten."""
    rng = np.random.default_rng(seed)
    vals = np.zeros(num_vals, codec.VAL_DTYPE)
    low, size = np.array([-1.5, 0, 0.25], np.float32), np.array([3.2, 2.4, 6.5], np.float32)
    vals["position"] = low + size * rng.uniform(size=(num_vals, 3))
    normal = rng.normal(size=(num_vals, 3))
    vals["normal"] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    vals["radiant_intensity"] = 10 ** rng.uniform(-4, 4, (num_vals, 3))
    vals["area"] = 10 ** rng.uniform(-6, 1, num_vals)
    vals["generation"] = rng.integers(0, 256, num_vals)
    sh = rng.normal(size=(num_objects, 9, 3)) * 10 ** rng.uniform(-3, 3, (num_objects, 1, 1))
    return codec.LightPacket(
        sequence=seed,
        timestamp_ns=2**53 + seed,
        room_revision=0xDEADBEEF,
        vals=vals,
        object_sh=sh.astype(np.float32),
        object_revisions=rng.integers(0, 2**32, num_objects, dtype=np.uint64).astype(np.uint32),
        bounds_min=low,
        bounds_size=size,
    )


def special_packet() -> codec.LightPacket:
    """Axes, corners of the bounds, empty slots, the smallest and largest numbers, -0 and denormals."""
    low, size = np.zeros(3, np.float32), np.ones(3, np.float32)
    vals = codec.empty_vals(10, low)
    vals["normal"][:8] = [
        (1, 0, 0),
        (-1, 0, 0),
        (0, 1, 0),
        (0, -1, 0),
        (0, 0, 1),
        (0, 0, -1),
        (0.6, 0, -0.8),
        (0, -0.6, -0.8),
    ]
    vals["position"][:4] = [(0, 0, 0), (1, 1, 1), (-0.0, 0.5, 1), (2**-140, 2**-149, 0.25)]
    intensities = [2.0**126, 1, 2.0**95, 2.0**96, 511.5, 1e-3, 2.0**-149, 65504]
    for slot, value in enumerate(intensities):
        vals["radiant_intensity"][slot] = (value, value / 3, 0)
    vals["area"][:8] = [0, 2.0**-50, 2.0**-52, 2.0**-39, 1, 2047 / 1024, 16769024.0, 0.0004]
    vals["generation"] = [0, 255, 128, 127, 1, 2, 3, 4, 5, 6]
    sh = np.zeros((3, 9, 3), np.float32)
    sh[0, 0] = (1, -0.0, 2.0**-140)
    sh[0, 1] = (-2047, 2048.5, 4095.9)
    sh[1, 8] = (2.0**-126, -(2.0**-149), 1e-20)
    return codec.LightPacket(
        sequence=0xFFFFFFFF,
        timestamp_ns=2**64 - 1,
        vals=vals,
        object_sh=sh,
        object_revisions=np.array([0, 1, 0xFFFFFFFF], np.uint32),
        bounds_min=low,
        bounds_size=size,
    )


def light_json(packet: codec.LightPacket) -> dict[str, Any]:
    """Decoded values of a light packet."""
    return {
        "sequence": number(packet.sequence),
        "timestamp_ns": number(packet.timestamp_ns),
        "room_revision": number(packet.room_revision),
        "bounds_min": numbers(packet.bounds_min),
        "bounds_size": numbers(packet.bounds_size),
        "vals": [{name: numbers(val[name]) for name in codec.VAL_DTYPE.names or ()} for val in packet.vals],
        "object_sh": [numbers(sh) for sh in packet.object_sh],
        "object_revisions": numbers(packet.object_revisions),
    }


def atlas_tiles() -> codec.AtlasTiles:
    """Two tiles with the corner cases of RGB9_E5."""
    rng = np.random.default_rng(5)
    radiance = 10 ** rng.uniform(-9, 5, (2, 32, 32, 3))
    radiance[0, 0, :4] = [(0, 0, 0), (65408, 1, 0), (2.0**-24, 0, 2.0**-25), (511.5, 511.5, 1)]
    return codec.AtlasTiles(
        sequence=9,
        timestamp_ns=123456789,
        room_revision=3,
        width=256,
        height=96,
        positions=np.array([(7, 0), (0, 2)], np.uint16),
        texels=codec.encode_radiance(radiance),
    )


def atlas_json(tiles: codec.AtlasTiles) -> dict[str, Any]:
    """Decoded values of an atlas message; of the texels only the first row of each tile as radiance."""
    return {
        "sequence": number(tiles.sequence),
        "timestamp_ns": number(tiles.timestamp_ns),
        "room_revision": number(tiles.room_revision),
        "width": number(tiles.width),
        "height": number(tiles.height),
        "positions": numbers(tiles.positions),
        "texel_sum": number(int(tiles.texels.astype(np.uint64).sum())),
        "first_row_radiance": [numbers(codec.decode_radiance(tile[0])) for tile in tiles.texels],
    }


def vectors() -> dict[str, tuple[str, bytes, dict[str, Any]]]:
    """Name -> (message, bytes, decoded values)."""
    found: dict[str, tuple[str, bytes, dict[str, Any]]] = {}
    packets = {
        "empty": random_packet(0, 0, 1),
        "typical": random_packet(16, 1, 2),
        "full": random_packet(64, 10, 3),
        "special": special_packet(),
    }
    for name, packet in packets.items():
        for encoding in codec.Encoding:
            data = codec.encode_light_packet(packet, encoding)
            values = {"encoding": encoding.name} | light_json(codec.decode_light_packet(data))
            found[f"light_{name}_{encoding.name.lower()}"] = ("light_packet", data, values)
    data = codec.encode_atlas_tiles(atlas_tiles())
    found["atlas_tiles"] = ("atlas_tiles", data, atlas_json(codec.decode_atlas_tiles(data)))
    pose = codec.WirePose(
        pose_revision=0xFFFFFFFF, position=(-0.0, 2.0**-149, 3.25), quaternion=(0.5, -0.5, 0.5, -0.5)
    )
    state = codec.ControlState(
        sequence=4, revision=17, light_weights=(0.0, 1.0, 0.1), object_poses=(pose, pose)
    )
    data = codec.encode_control_state(state)
    decoded = codec.decode_control_state(data)
    found["control_state"] = (
        "control_state",
        data,
        {
            "sequence": number(decoded.sequence),
            "revision": number(decoded.revision),
            "light_weights": numbers(decoded.light_weights),
            "object_poses": [
                {
                    "pose_revision": number(p.pose_revision),
                    "position": numbers(p.position),
                    "quaternion": numbers(p.quaternion),
                }
                for p in decoded.object_poses
            ],
        },
    )
    ages = (0.25, math.inf, math.nan, 2.0**-149, 0.0)
    data = codec.encode_status(
        codec.Status(sequence=8, server_time_ns=2**63, light_age=math.nan, camera_ages=ages, is_stale=True)
    )
    status = codec.decode_status(data)
    found["status"] = (
        "status",
        data,
        {
            "sequence": number(status.sequence),
            "server_time_ns": number(status.server_time_ns),
            "light_age": number(status.light_age),
            "camera_ages": numbers(status.camera_ages),
            "is_stale": number(int(status.is_stale)),
        },
    )
    ack = codec.Ack(
        sequence=1, acknowledged_type=codec.MessageType.LIGHT_PACKET, acknowledged_sequence=0xFFFFFFFF
    )
    found["ack"] = _client(ack, acknowledged_type="1", acknowledged_sequence="4294967295")
    subscribe = codec.Subscribe(sequence=2, encoding=codec.Encoding.PLAIN, wants_atlas=True)
    found["subscribe"] = _client(subscribe, encoding="0", wants_atlas="1")
    move = codec.SetObjectPose(
        sequence=3, object_index=2, position=(-1.5, 0.0, 1e-3), quaternion=(0.0, 0.6, 0.0, 0.8)
    )
    found["set_object_pose"] = _client(
        move,
        object_index="2",
        position=numbers(np.array(move.position, np.float32)),
        quaternion=numbers(np.array(move.quaternion, np.float32)),
    )
    dim = codec.SetLightWeight(sequence=4, light_index=1, weight=2.0**-149)
    found["set_light_weight"] = _client(dim, light_index="1", weight=number(2.0**-149))
    return found


def _client(message: codec.ClientMessage, **fields: Any) -> tuple[str, bytes, dict[str, Any]]:
    return (
        "client_message",
        codec.encode_client_message(message),
        {"sequence": number(message.sequence)} | fields,
    )


def outputs() -> dict[Path, bytes]:
    """Every file with the bytes that it should hold."""
    files: dict[Path, bytes] = {}
    for name, (message, data, values) in vectors().items():
        text = json.dumps({"name": name, "message": message, "value": values}, indent=1) + "\n"
        files[FOLDER / f"{name}.bin"] = data
        files[FOLDER / f"{name}.json"] = text.encode()
    return files


def main(arguments: list[str]) -> int:
    """Entry point."""
    check = "--check" in arguments
    wanted = outputs()
    problems = [f"unexpected: {path.name}" for path in sorted(FOLDER.glob("*")) if path not in wanted]
    for path, data in wanted.items():
        if not path.exists() or path.read_bytes() != data:
            problems.append(f"{'out of date' if check else 'written'}: {path.name}")
            if not check:
                FOLDER.mkdir(exist_ok=True)
                path.write_bytes(data)
    sys.stdout.write("".join(line + "\n" for line in problems))
    return 1 if check and problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

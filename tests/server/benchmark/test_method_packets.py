from dataclasses import replace

import numpy as np

from nearfield_protocol.codec import decode_light_packet
from nearfield_server.benchmark.method_packets import MethodPackets
from nearfield_server.benchmark.methods.light import MethodLight, make_vals
from nearfield_server.reference.box_room import make_box_room

MESH = replace(make_box_room(atlas_size=48, camera_size=48).mesh(), content_hash="0" * 64)


def _light(count: int, reach: float = 1.0) -> MethodLight:
    rng = np.random.default_rng(count)
    normal = np.tile([0.0, -1.0, 0.0], (count, 1))
    vals = make_vals(reach * rng.random((count, 3)), normal, np.ones((count, 3)), np.full(count, 0.01))
    return MethodLight(vals=vals, object_sh=rng.random((2, 9, 3)).astype(np.float32))


def test_more_than_64_lights_take_turns_and_the_sh_come_once() -> None:
    packets = MethodPackets(MESH)
    light = _light(130)
    turns = [decode_light_packet(data) for data in packets.turns(light)]
    assert [len(turn.vals) for turn in turns] == [64, 64, 2]
    assert [turn.sequence for turn in turns] == [1, 2, 3]
    assert turns[0].object_sh.any()
    assert not turns[1].object_sh.any()
    np.testing.assert_allclose(
        np.concatenate([turn.vals["position"] for turn in turns]), light.vals["position"], atol=2e-4
    )


def test_bytes_grow_by_the_light_alone() -> None:
    packets = MethodPackets(MESH)
    sizes = [packets.num_bytes(_light(count)) for count in (8, 16, 64, 128, 512)]
    per_light = (sizes[1] - sizes[0]) / 8
    assert sizes == [sizes[0] + per_light * (count - 8) for count in (8, 16, 64, 128, 512)]


def test_lights_outside_the_room_keep_their_place() -> None:
    light = _light(3, reach=40.0)
    (data,) = MethodPackets(MESH).turns(light)
    np.testing.assert_allclose(decode_light_packet(data).vals["position"], light.vals["position"], atol=2e-3)

"""Real websockets against uvicorn on loopback."""

from __future__ import annotations

import socket
import time

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from nearfield_protocol import codec
from nearfield_protocol.session import SessionLimits

from .conftest import StartGateway, Tablet, atlas_bytes, light_bytes

POSE = codec.WirePose(pose_revision=3, position=(1.0, 2.0, 3.0), quaternion=(0.0, 0.0, 0.0, 1.0))


def state(revision: int) -> codec.ControlState:
    return codec.ControlState(sequence=0, revision=revision, light_weights=(0.5,), object_poses=(POSE,))


def receive_for_ever(tablet: Tablet) -> None:
    while True:
        tablet.websocket.recv(5)


def send_slowly(tablet: Tablet, messages: list[bytes]) -> None:
    for data in messages:
        tablet.websocket.send(data)
        time.sleep(0.001)


def closed_with(tablet: Tablet) -> tuple[int, str]:
    with pytest.raises(ConnectionClosed) as caught:
        receive_for_ever(tablet)
    assert caught.value.rcvd is not None
    return caught.value.rcvd.code, caught.value.rcvd.reason


def test_newcomer_gets_what_holds_now(start_gateway: StartGateway) -> None:
    gateway = start_gateway()
    gateway.hub.publish_control(state(5))
    gateway.hub.publish_light(light_bytes(1))
    tablet = gateway.tablet()
    assert tablet.read().revision == 5
    assert isinstance(tablet.read(), codec.Status)
    assert tablet.read().sequence == 1


def test_newest_light_wins_and_one_is_in_flight(start_gateway: StartGateway) -> None:
    gateway = start_gateway()
    tablet = gateway.tablet()
    gateway.hub.publish_light(light_bytes(1))
    assert tablet.read_until(codec.LightPacket, acknowledge=False).sequence == 1
    for sequence in range(2, 50):
        gateway.hub.publish_light(light_bytes(sequence))
    # Nothing but status arrives until the first packet is acknowledged.
    end = time.monotonic() + 0.7
    while time.monotonic() < end:
        assert isinstance(tablet.read(acknowledge=False), codec.Status)
    tablet.flush()
    assert tablet.read_until(codec.LightPacket).sequence == 49


def test_repeated_packet_is_not_sent_again(start_gateway: StartGateway) -> None:
    gateway = start_gateway()
    tablet = gateway.tablet()
    for sequence in (1, 1, 1, 2):
        gateway.hub.publish_light(light_bytes(sequence))
    received = [tablet.read_until(codec.LightPacket).sequence]
    while received[-1] != 2:
        received.append(tablet.read_until(codec.LightPacket).sequence)
    assert received in ([1, 2], [2])


def test_light_that_stays_is_kept_alive_by_heartbeats_alone(start_gateway: StartGateway) -> None:
    """The illumination process repeats its packet every second for gateways that have just started; tablets hear none of it."""
    gateway = start_gateway()
    tablet = gateway.tablet()
    gateway.hub.publish_light(light_bytes(1))
    tablet.read_until(codec.LightPacket)
    received = []
    for _ in range(3):
        gateway.hub.publish_light(light_bytes(1))
        received.append(tablet.websocket.recv(5))
    assert {codec.peek_header(data).message_type for data in received} == {codec.MessageType.STATUS}
    assert max(map(len, received)) <= 32 + 4 * len(codec.decode_status(received[0]).camera_ages)


def test_plain_encoding_on_request(start_gateway: StartGateway) -> None:
    gateway = start_gateway()
    tablet = gateway.tablet()
    tablet.session.subscribe(encoding=codec.Encoding.PLAIN)
    tablet.flush()
    time.sleep(0.1)
    gateway.hub.publish_light(light_bytes(1))
    while True:
        data = tablet.websocket.recv(5)
        if codec.peek_header(data).message_type == codec.MessageType.LIGHT_PACKET:
            break
    assert len(data) == 80 + 16 * 32 + 108 + 4


def test_requests_go_out_and_states_come_back(start_gateway: StartGateway) -> None:
    gateway = start_gateway()
    tablet = gateway.tablet()
    tablet.session.set_light_weight(0, 0.25)
    tablet.session.set_object_pose(0, (1.0, 0.0, 0.0), (0.0, 0.6, 0.0, 0.8))
    tablet.flush()
    tablet.read_until(codec.Status)
    end = time.monotonic() + 5
    while len(gateway.requests.taken) < 2 and time.monotonic() < end:
        time.sleep(0.01)
    dim, move = gateway.requests.taken
    assert isinstance(dim, codec.SetLightWeight)
    assert isinstance(move, codec.SetObjectPose)
    gateway.hub.publish_control(state(9))
    assert tablet.read_until(codec.ControlState).object_poses == (POSE,)


def test_atlas_for_subscribers_old_tiles_included(start_gateway: StartGateway) -> None:
    gateway = start_gateway()
    wishes: list[bool] = []
    gateway.hub.on_atlas_wanted = wishes.append
    gateway.hub.publish_atlas(atlas_bytes(1, [(column, 0) for column in range(6)]))
    gateway.hub.publish_atlas(atlas_bytes(2, [(3, 0), (7, 7)]))
    tablet = gateway.tablet()
    tablet.session.subscribe(wants_atlas=True)
    tablet.flush()
    seen: dict[tuple[int, ...], int] = {}
    while len(seen) < 7:
        tiles = tablet.read_until(codec.AtlasTiles)
        for place, texels in zip(tiles.positions.tolist(), tiles.texels, strict=True):
            seen[tuple(place)] = int(texels[0, 0])
    assert seen == {**{(column, 0): 1 for column in range(6)}, (3, 0): 2, (7, 7): 2}
    assert wishes == [True]
    tablet.websocket.close()
    end = time.monotonic() + 5
    while wishes != [True, False] and time.monotonic() < end:
        time.sleep(0.01)
    assert wishes == [True, False]


def test_stalled_reader_is_dropped_and_harms_nobody(start_gateway: StartGateway) -> None:
    gateway = start_gateway(limits=SessionLimits(ack_timeout=1.0), user_timeout_ms=1000)
    stalled, healthy = gateway.tablet(), gateway.tablet()
    stalled.read()
    # The stalled client reads nothing any more; so much control and light that its socket fills up.
    for sequence in range(1, 31):
        gateway.hub.publish_light(light_bytes(sequence, 64))
        assert healthy.read_until(codec.LightPacket, timeout=1.0).sequence == sequence
    end = time.monotonic() + 6
    while gateway.hub.num_clients > 1 and time.monotonic() < end:
        time.sleep(0.05)
    assert gateway.hub.num_clients == 1
    gateway.hub.publish_light(light_bytes(99))
    assert healthy.read_until(codec.LightPacket).sequence == 99


def test_reader_with_a_full_socket_is_dropped(start_gateway: StartGateway) -> None:
    """A client below the websocket library: it completes the handshake and then never reads."""
    gateway = start_gateway(limits=SessionLimits(ack_timeout=60.0, control_queue=8), user_timeout_ms=1000)
    with socket.create_connection(("127.0.0.1", gateway.port)) as raw:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        lines = [
            "GET /ws HTTP/1.1",
            f"Host: 127.0.0.1:{gateway.port}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Protocol: nearfield.v1",
        ]
        raw.sendall("\r\n".join([*lines, "", ""]).encode())
        assert raw.recv(12) == b"HTTP/1.1 101"
        poses = (POSE,) * 256
        end = time.monotonic() + 10
        revision = 0
        while (gateway.hub.num_clients or not revision) and time.monotonic() < end:
            revision += 1
            big = codec.ControlState(sequence=0, revision=revision, light_weights=(), object_poses=poses)
            gateway.hub.publish_control(big)
            time.sleep(0.005)
        assert gateway.hub.num_clients == 0
        assert revision > 8


def test_compression_is_declined(start_gateway: StartGateway) -> None:
    """permessage-deflate lets 15 kB grow to 15 MB in the server."""
    tablet = start_gateway().tablet(compression="deflate")
    assert tablet.websocket.response is not None
    assert "Sec-WebSocket-Extensions" not in tablet.websocket.response.headers


@pytest.mark.parametrize("offered", ["nearfield.v2", "nearfield.v0"])
def test_other_version_is_told_to_reload(start_gateway: StartGateway, offered: str) -> None:
    tablet = start_gateway().tablet(subprotocols=[offered])
    assert tablet.websocket.subprotocol == offered
    code, reason = closed_with(tablet)
    assert code == 4001
    assert reason == f"this page speaks {offered}, the server nearfield.v1: reload the page"


def test_other_packet_version_is_told_to_reload(start_gateway: StartGateway) -> None:
    tablet = start_gateway().tablet()
    tablet.session.set_light_weight(0, 1.0)
    data = bytearray(tablet.session.take_outgoing()[0])
    data[4] = 2
    tablet.websocket.send(bytes(data))
    assert closed_with(tablet) == (4001, "the page speaks version 2, the server 1: reload the page")


def test_no_subprotocol_is_refused_with_words(start_gateway: StartGateway) -> None:
    with pytest.raises(InvalidStatus) as caught:
        start_gateway().tablet(subprotocols=None)
    assert caught.value.response.status_code == 400
    assert b"nearfield.v1" in caught.value.response.body


@pytest.mark.parametrize(
    ("message", "code"), [("text", 4002), (b"junk", 4002), (bytes(300), 4002), (bytes(70_000), 1009)]
)
def test_broken_messages(start_gateway: StartGateway, message: str | bytes, code: int) -> None:
    gateway = start_gateway()
    tablet = gateway.tablet()
    tablet.websocket.send(message)
    assert closed_with(tablet)[0] == code
    assert gateway.tablet().read()


def test_rate_limit(start_gateway: StartGateway) -> None:
    gateway = start_gateway()
    tablet = gateway.tablet()
    for _ in range(100):
        tablet.session.set_light_weight(0, 1.0)
    with pytest.raises(ConnectionClosed) as caught:
        send_slowly(tablet, tablet.session.take_outgoing() * 3)
    assert caught.value.rcvd is not None
    assert caught.value.rcvd.code == 1008
    assert "more than 20 control messages per second" in caught.value.rcvd.reason


def test_too_many_clients(start_gateway: StartGateway) -> None:
    gateway = start_gateway(max_clients=2)
    first, second = gateway.tablet(), gateway.tablet()
    first.read()
    second.read()
    code, reason = closed_with(gateway.tablet())
    assert code == 4013
    assert reason.startswith("2 tablets are connected")
    first.websocket.close()
    end = time.monotonic() + 5
    while gateway.hub.num_clients > 1 and time.monotonic() < end:
        time.sleep(0.01)
    assert gateway.tablet().read()


def test_server_stop_says_that_it_restarts(start_gateway: StartGateway) -> None:
    gateway = start_gateway()
    tablet = gateway.tablet()
    tablet.read()
    gateway.stop()
    assert closed_with(tablet)[0] == 1012

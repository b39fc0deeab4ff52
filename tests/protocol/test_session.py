"""Laws of a session, without sockets or clocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nearfield_protocol import codec
from nearfield_protocol.errors import DecodeError, SessionError, UnexpectedTypeError
from nearfield_protocol.layout import CloseCode
from nearfield_protocol.session import (
    ClientSession,
    LightOffer,
    ServerSession,
    SessionLimits,
    negotiate,
    short_reason,
)


def light(sequence: int) -> LightOffer:
    packet = codec.LightPacket(
        sequence=sequence,
        timestamp_ns=0,
        vals=codec.empty_vals(2, np.zeros(3, np.float32)),
        object_sh=np.full((1, 9, 3), 0.1, np.float32),
        object_revisions=np.zeros(1, np.uint32),
        bounds_min=np.zeros(3, np.float32),
        bounds_size=np.ones(3, np.float32),
    )
    return LightOffer(codec.encode_light_packet(packet))


def atlas(value: int, places: list[tuple[int, int]]) -> codec.AtlasTiles:
    return codec.AtlasTiles(
        sequence=0,
        timestamp_ns=0,
        width=256,
        height=256,
        positions=np.array(places, np.uint16).reshape(-1, 2),
        texels=np.full((len(places), 32, 32), value, np.uint32),
    )


def exchange(server: ServerSession, client: ClientSession, now: float = 0.0) -> list:
    """Let messages flow until nobody has anything to say."""
    received = []
    while True:
        for data in client.take_outgoing():
            server.receive(data, now)
        data = server.next_message(now)
        if data is None:
            return received
        received.append(client.receive(data))


@pytest.mark.parametrize(
    ("offered", "subprotocol", "code"),
    [
        (["nearfield.v1"], "nearfield.v1", None),
        (["other", "nearfield.v2", "nearfield.v1"], "nearfield.v1", None),
        (["nearfield.v2"], "nearfield.v2", CloseCode.VERSION_MISMATCH),
        (["soap", "nearfield.v0", "nearfield.v2"], "nearfield.v0", CloseCode.VERSION_MISMATCH),
        (["soap"], None, None),
        (["nearfield.v1\r\n"], None, None),
        ([], None, None),
    ],
)
def test_handshake(offered: list[str], subprotocol: str | None, code: CloseCode | None) -> None:
    answer = negotiate(offered)
    assert (answer.subprotocol, answer.close_code) == (subprotocol, code)
    if code:
        assert answer.reason.endswith("reload the page")
        assert len(answer.reason.encode()) <= 123


def test_newest_light_wins_while_one_is_in_flight() -> None:
    server, client = ServerSession(), ClientSession()
    server.offer_light(light(1))
    first = server.next_message(0.0)
    for sequence in (2, 3, 4):
        server.offer_light(light(sequence))
        assert server.next_message(0.1) is None
    assert client.receive(first).sequence == 1
    assert [message.sequence for message in exchange(server, client)] == [4]
    assert server.num_light_replaced == 2


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(["offer", "send", "read"]), max_size=60))
def test_light_arrives_in_order_and_the_last_one_always(steps: list[str]) -> None:
    server, client = ServerSession(), ClientSession()
    wire: list[bytes] = []
    sent, received = 0, []
    for step in [*steps, *["send", "read"] * 3]:
        if step == "offer":
            sent += 1
            server.offer_light(light(sent))
        elif step == "send":
            data = server.next_message(0.0)
            wire += [] if data is None else [data]
            assert len(wire) <= 1
        elif wire:
            received.append(client.receive(wire.pop()).sequence)
            for data in client.take_outgoing():
                server.receive(data, 0.0)
    assert received == sorted(set(received))
    assert (received[-1] if received else 0) == sent


def test_control_is_never_dropped_and_comes_first() -> None:
    server, client = ServerSession(), ClientSession()
    server.offer_light(light(1))
    for revision in range(64):
        server.offer_control(
            codec.encode_control_state(
                codec.ControlState(sequence=revision, revision=revision, light_weights=(), object_poses=())
            )
        )
    with pytest.raises(SessionError) as caught:
        server.offer_control(b"")
    assert caught.value.close_code == CloseCode.QUEUE_FULL
    messages = exchange(server, client)
    assert [message.revision for message in messages[:-1]] == list(range(64))
    assert isinstance(messages[-1], codec.LightPacket)


def test_waiting_status_is_replaced() -> None:
    server, client = ServerSession(), ClientSession()
    for sequence in (1, 2):
        server.offer_status(
            codec.encode_status(
                codec.Status(
                    sequence=sequence, server_time_ns=0, light_age=0.0, camera_ages=(), is_stale=False
                )
            )
        )
    assert [message.sequence for message in exchange(server, client)] == [2]


def test_atlas_is_sent_to_subscribers_only_newest_tile_first_come() -> None:
    server, client = ServerSession(), ClientSession()
    server.offer_atlas(atlas(1, [(0, 0)]))
    assert server.next_message(0.0) is None
    client.subscribe(wants_atlas=True)
    assert exchange(server, client) == []
    places = [(column, row) for row in range(2) for column in range(8)]
    server.offer_atlas(atlas(1, places))
    server.offer_atlas(atlas(2, [(3, 1)]))
    messages = exchange(server, client)
    assert [len(message.positions) for message in messages] == [4, 4, 4, 4]
    assert [tuple(place) for message in messages for place in message.positions.tolist()] == places
    values = {
        tuple(place): int(tile[0, 0])
        for m in messages
        for place, tile in zip(m.positions.tolist(), m.texels, strict=True)
    }
    assert values == {place: 2 if place == (3, 1) else 1 for place in places}


def test_light_overtakes_waiting_atlas() -> None:
    server, client = ServerSession(), ClientSession()
    client.subscribe(wants_atlas=True)
    exchange(server, client)
    server.offer_atlas(atlas(1, [(column, 0) for column in range(8)]))
    first = server.next_message(0.0)
    server.offer_light(light(1))
    assert isinstance(client.receive(server.next_message(0.0)), codec.LightPacket)
    assert isinstance(client.receive(first), codec.AtlasTiles)
    assert len(exchange(server, client)) == 1


def test_plain_on_request_holds_the_same_light() -> None:
    server, client = ServerSession(), ClientSession()
    client.subscribe(encoding=codec.Encoding.PLAIN)
    exchange(server, client)
    offer = light(5)
    server.offer_light(offer)
    (packet,) = exchange(server, client)
    compact = codec.decode_light_packet(offer.encoded(codec.Encoding.COMPACT))
    np.testing.assert_array_equal(packet.object_sh, compact.object_sh)
    assert len(offer.encoded(codec.Encoding.PLAIN)) > len(offer.encoded(codec.Encoding.COMPACT))


def test_requests_reach_the_application() -> None:
    server, client = ServerSession(), ClientSession()
    client.set_object_pose(1, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    client.set_light_weight(2, 0.5)
    move, dim = (server.receive(data, 0.0) for data in client.take_outgoing())
    assert isinstance(move, codec.SetObjectPose)
    assert move.position == (1.0, 2.0, 3.0)
    assert isinstance(dim, codec.SetLightWeight)
    assert (dim.light_index, dim.weight) == (2, 0.5)


def test_rate_limit_allows_twenty_per_second() -> None:
    server, client = ServerSession(), ClientSession()

    def send(now: float) -> None:
        client.set_light_weight(0, 1.0)
        for data in client.take_outgoing():
            server.receive(data, now)

    for i in range(400):
        send(i / 20)
    for _ in range(39):
        send(20.0)
    with pytest.raises(SessionError, match="more than 20") as caught:
        send(20.0)
    assert caught.value.close_code == CloseCode.RATE_LIMITED


def test_acknowledgements_of_nothing_count_as_messages() -> None:
    server = ServerSession(SessionLimits(control_burst=3))
    ack = codec.encode_client_message(
        codec.Ack(sequence=0, acknowledged_type=codec.MessageType.LIGHT_PACKET, acknowledged_sequence=7)
    )
    for _ in range(3):
        assert server.receive(ack, 0.0) is None
    with pytest.raises(SessionError):
        server.receive(ack, 0.0)


def test_unacknowledged_light_closes_the_session() -> None:
    server, client = ServerSession(SessionLimits(ack_timeout=2.0)), ClientSession()
    server.offer_light(light(1))
    data = server.next_message(10.0)
    server.check(12.0)
    with pytest.raises(SessionError) as caught:
        server.check(12.1)
    assert caught.value.close_code == CloseCode.STALLED
    client.receive(data)
    exchange(server, client)
    server.check(100.0)


@pytest.mark.parametrize(
    ("data", "code"),
    [
        ("text", CloseCode.MALFORMED_MESSAGE),
        (b"", CloseCode.MALFORMED_MESSAGE),
        (b"\0" * 300, CloseCode.MALFORMED_MESSAGE),
        (b"NFLD\x02\x00" + bytes(18), CloseCode.VERSION_MISMATCH),
    ],
)
def test_broken_messages_close_with_words(data: bytes | str, code: CloseCode) -> None:
    with pytest.raises(SessionError) as caught:
        ServerSession().receive(data, 0.0)
    assert caught.value.close_code == code
    assert 0 < len(caught.value.reason.encode()) <= 123


def test_client_refuses_what_only_clients_send() -> None:
    client = ClientSession()
    client.set_light_weight(0, 1.0)
    with pytest.raises(UnexpectedTypeError):
        ClientSession().receive(client.take_outgoing()[0])
    with pytest.raises(DecodeError):
        client.receive(b"NFLD")


def test_reasons_fit_into_a_close_frame() -> None:
    assert short_reason("é" * 100) == "é" * 61

"""The hub without a network: what is kept, and what is told to whom."""

from __future__ import annotations

import asyncio
import math
import threading
import time

import pytest

from nearfield_protocol import codec
from nearfield_protocol.errors import DecodeError
from nearfield_protocol.session import ClientSession, SessionLimits
from nearfield_server.gateway.hub import Client, LightHealth, LightHub

from .conftest import atlas_bytes, light_bytes


def drain(client: Client, session: ClientSession) -> list:
    received = []
    while (data := client.session.next_message(0.0)) is not None:
        received.append(session.receive(data))
        for answer in session.take_outgoing():
            client.session.receive(answer, 0.0)
    return received


async def test_what_is_published_before_anybody_comes_is_kept() -> None:
    hub = LightHub()
    hub.publish_light(light_bytes(1))
    hub.publish_light(light_bytes(2))
    messages = drain(hub.join(), ClientSession())
    assert [message.sequence for message in messages if isinstance(message, codec.LightPacket)] == [2]


async def test_any_thread_may_publish() -> None:
    hub = LightHub()
    hub.attach(asyncio.get_running_loop())
    client, session = hub.join(), ClientSession()
    thread = threading.Thread(target=hub.publish_light, args=(light_bytes(1),))
    thread.start()
    thread.join()
    client.wake.clear()
    async with asyncio.timeout(5):
        await client.wake.wait()
    assert drain(client, session)[-1].sequence == 1
    hub.detach()


async def test_one_encoding_is_made_once_for_all() -> None:
    hub = LightHub()
    hub.publish_light(light_bytes(1))
    offer = hub.light
    assert offer is not None
    assert offer.encoded(codec.Encoding.PLAIN) is offer.encoded(codec.Encoding.PLAIN)
    assert offer.encoded(codec.Encoding.COMPACT) is offer.data


async def test_slow_reader_of_control_states_is_marked_and_others_are_not() -> None:
    hub = LightHub(limits=SessionLimits(control_queue=3))
    slow, fast = hub.join(), hub.join()
    session = ClientSession()
    for revision in range(5):
        hub.publish_control(
            codec.ControlState(sequence=0, revision=revision, light_weights=(), object_poses=())
        )
        drain(fast, session)
    assert slow.fault is not None
    assert slow.fault.close_code == 4008
    assert fast.fault is None


async def test_atlas_of_another_room_replaces_the_old_one() -> None:
    hub = LightHub()
    hub.publish_atlas(atlas_bytes(1, [(0, 0), (1, 1)]))
    hub.publish_atlas(atlas_bytes(2, [(2, 0)], tiles=4))
    client, session = hub.join(), ClientSession()
    session.subscribe(wants_atlas=True)
    for data in session.take_outgoing():
        message = client.session.receive(data, 0.0)
        assert isinstance(message, codec.Subscribe)
        hub.subscribe(client, message, False)
    tiles = [message for message in drain(client, session) if isinstance(message, codec.AtlasTiles)]
    assert [(message.width, message.positions.tolist()) for message in tiles] == [(128, [[2, 0]])]


def test_a_repeated_packet_is_not_even_read(monkeypatch: pytest.MonkeyPatch) -> None:
    hub = LightHub()
    hub.publish_light(light_bytes(1))
    monkeypatch.setattr("nearfield_server.gateway.hub.LightOffer", None)
    hub.publish_light(light_bytes(1))
    with pytest.raises(TypeError):
        hub.publish_light(light_bytes(2))


def test_no_heartbeat_is_made_for_nobody() -> None:
    hub = LightHub()
    hub.send_status()
    client = hub.join()
    [status] = drain(client, ClientSession())
    assert status.sequence == 1
    hub.send_status()
    assert [status.sequence for status in drain(client, ClientSession())] == [2]


def test_junk_is_refused_where_it_is_published() -> None:
    hub = LightHub()
    with pytest.raises(DecodeError):
        hub.publish_light(b"junk")
    with pytest.raises(DecodeError):
        hub.publish_atlas(light_bytes(1))


def test_age_of_the_light_is_the_younger_of_report_and_packet() -> None:
    hub = LightHub()
    assert hub.light_health() == (math.inf, (), True)
    now = time.monotonic()
    hub.publish_health(LightHealth(light_age=0.4, camera_ages=(0.4, 0.1), reported=now))
    age, cameras, is_stale = hub.light_health()
    assert 0.4 <= age < 0.9
    assert len(cameras) == 2
    assert not is_stale
    fresh = codec.decode_light_packet(light_bytes(1))
    hub.publish_light(
        codec.encode_light_packet(
            codec.LightPacket(
                sequence=2,
                timestamp_ns=time.monotonic_ns(),
                vals=fresh.vals,
                object_sh=fresh.object_sh,
                object_revisions=fresh.object_revisions,
                bounds_min=fresh.bounds_min,
                bounds_size=fresh.bounds_size,
            )
        )
    )
    assert hub.light_health()[0] < age
    hub.publish_health(LightHealth(light_age=0.0, is_stale=True, reported=now))
    assert hub.light_health()[2]

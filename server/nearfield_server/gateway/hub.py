"""The newest of everything, handed to every client: one slot for light, one per atlas tile, a queue for control states."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nearfield_protocol.codec import (
    AtlasTiles,
    ControlState,
    Status,
    Subscribe,
    cut_tiles,
    decode_atlas_tiles,
    encode_control_state,
    encode_status,
    paste_tiles,
)
from nearfield_protocol.errors import SessionError
from nearfield_protocol.layout import ATLAS_TILE_SIZE, MAX_CAMERAS
from nearfield_protocol.session import LightOffer, ServerSession, SessionLimits
from nearfield_server.gateway.metrics import GatewayMetrics


@dataclass(frozen=True, slots=True, kw_only=True)
class LightHealth:
    """What the illumination process said last.

    Attributes:
        light_age: seconds since the capture of the oldest frame in use; infinite before the first.
        camera_ages: per camera, in the order of the room file.
        is_stale: some camera has stopped.
        reported: when it was said, `time.monotonic()`.
    """

    light_age: float
    camera_ages: tuple[float, ...] = ()
    is_stale: bool = False
    reported: float


@dataclass(eq=False, slots=True)
class Client:
    """One connected tablet. `session` and `fault` belong to the event loop."""

    session: ServerSession
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    fault: SessionError | None = None

    def fail(self, error: SessionError) -> None:
        """Remember why the connection must be closed and wake its tasks."""
        self.fault = self.fault or error
        self.wake.set()


class LightHub:
    """Publishes to all clients. The `publish_*` methods may be called from any thread.

    Args:
        limits: of every session.
        max_clients: connections at the same time.
        stale_after: seconds; light older than this is called stale.
        health_timeout: seconds without a report after which the light is called stale.
    """

    def __init__(
        self,
        *,
        limits: SessionLimits | None = None,
        max_clients: int = 32,
        stale_after: float = 1.0,
        health_timeout: float = 2.0,
        metrics: GatewayMetrics | None = None,
    ) -> None:
        self.limits = limits or SessionLimits()
        self.max_clients = max_clients
        self.metrics = metrics or GatewayMetrics()
        self.metrics.light_age.set_function(lambda: self.light_health()[0])
        self._stale_after, self._health_timeout = stale_after, health_timeout
        self._clients: set[Client] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._loop_thread = 0
        self._light: LightOffer | None = None
        self._atlas: AtlasTiles | None = None
        self._atlas_words: NDArray[np.uint32] | None = None
        self._atlas_known: NDArray[np.bool_] | None = None
        self._control: bytes | None = None
        self._control_sequence = 0
        self._status_sequence = 0
        self._health: LightHealth | None = None
        self.on_atlas_wanted: Callable[[bool], None] | None = None
        """Called on the event loop when the first client asks for the atlas, or the last one no longer does."""

    # --- from outside ---

    def publish_light(self, data: bytes) -> None:
        """Send a light packet (either encoding) to every client; newest wins. A repeated packet is not sent again.

        Raises:
            DecodeError: not a light packet.
        """
        light = self._light
        if light is not None and light.data == data:
            return  # repeated for gateways that have just started
        offer = LightOffer(data)
        self._run(lambda: self._take_light(offer))

    def publish_atlas(self, data: bytes) -> None:
        """Send changed atlas tiles to the clients that want them, and keep them for those who come later.

        Raises:
            DecodeError: not an atlas message.
        """
        tiles = decode_atlas_tiles(data)
        self._run(lambda: self._take_atlas(tiles))

    def publish_control(self, state: ControlState) -> None:
        """Send a control state to every client. Its sequence is set here."""
        self._run(lambda: self._take_control(state))

    def publish_health(self, health: LightHealth) -> None:
        """Take over the report of the illumination process."""
        self._run(lambda: setattr(self, "_health", health))

    # --- on the event loop ---

    def attach(self, loop: asyncio.AbstractEventLoop) -> None:
        """Bind the hub to the running loop; until then nothing is delivered, only kept."""
        self._loop, self._loop_thread = loop, threading.get_ident()

    def detach(self) -> None:
        """Undo `attach`."""
        self._loop = None

    @property
    def num_clients(self) -> int:
        """Connected clients."""
        return len(self._clients)

    @property
    def is_full(self) -> bool:
        """Whether no further client may join."""
        return len(self._clients) >= self.max_clients

    @property
    def atlas_wanted(self) -> bool:
        """Whether any client asks for the atlas."""
        return any(client.session.wants_atlas for client in self._clients)

    @property
    def light(self) -> LightOffer | None:
        """The newest light packet."""
        return self._light

    def join(self) -> Client:
        """Add a client and give it everything that holds now."""
        client = Client(ServerSession(self.limits))
        self._clients.add(client)
        self.metrics.clients.set(len(self._clients))
        if self._control is not None:
            client.session.offer_control(self._control)
        client.session.offer_status(self._status())
        if self._light is not None:
            client.session.offer_light(self._light)
        client.wake.set()
        return client

    def leave(self, client: Client) -> None:
        """Remove a client."""
        wanted = self.atlas_wanted
        self._clients.discard(client)
        self.metrics.clients.set(len(self._clients))
        self.metrics.light_replaced.inc(client.session.num_light_replaced)
        self._notice_atlas_wish(wanted)

    def subscribe(self, client: Client, message: Subscribe, wanted_before: bool) -> None:
        """Act on a changed subscription, which the session has already taken over."""
        if message.wants_atlas and self._atlas is not None:
            assert self._atlas_words is not None
            assert self._atlas_known is not None
            known = np.argwhere(self._atlas_known)[:, ::-1].astype(np.uint16)
            client.session.offer_atlas(
                AtlasTiles(
                    sequence=0,
                    timestamp_ns=self._atlas.timestamp_ns,
                    room_revision=self._atlas.room_revision,
                    width=self._atlas.width,
                    height=self._atlas.height,
                    positions=known,
                    texels=cut_tiles(self._atlas_words, known),
                )
            )
        client.wake.set()
        self._notice_atlas_wish(wanted_before)

    def send_status(self) -> None:
        """Send the heartbeat to everybody; it is not even made when nobody is there."""
        if not self._clients:
            return
        data = self._status()
        for client in self._clients:
            client.session.offer_status(data)
            client.wake.set()

    def light_health(self) -> tuple[float, tuple[float, ...], bool]:
        """Age of the light in seconds, ages of the cameras, and whether the light is stale."""
        now = time.monotonic()
        health = self._health
        packet_age = math.inf
        if self._light is not None:
            # Capture times are CLOCK_MONOTONIC of this machine, as is time.monotonic_ns().
            packet_age = max(0.0, (time.monotonic_ns() - self._light.timestamp_ns) * 1e-9)
        if health is None:
            return packet_age, (), packet_age > self._stale_after
        silent = now - health.reported
        ages = tuple(age + silent for age in health.camera_ages[:MAX_CAMERAS])
        # Light that does not change is not sent again: then the report is the newer word.
        age = min(packet_age, health.light_age + silent)
        return age, ages, health.is_stale or silent > self._health_timeout or age > self._stale_after

    def _status(self) -> bytes:
        light_age, camera_ages, is_stale = self.light_health()
        self._status_sequence += 1
        return encode_status(
            Status(
                sequence=self._status_sequence,
                server_time_ns=time.monotonic_ns(),
                light_age=light_age,
                camera_ages=camera_ages,
                is_stale=is_stale,
            )
        )

    def _run(self, action: Callable[[], None]) -> None:
        loop = self._loop
        if loop is None or threading.get_ident() == self._loop_thread:
            action()
        else:
            loop.call_soon_threadsafe(action)

    def _take_light(self, offer: LightOffer) -> None:
        last = self._light
        if last is not None and last.data == offer.data:
            return
        self.metrics.light_packets.inc()
        self._light = offer
        for client in self._clients:
            client.session.offer_light(offer)
            client.wake.set()

    def _take_control(self, state: ControlState) -> None:
        self._control_sequence += 1
        self._control = encode_control_state(
            ControlState(
                sequence=self._control_sequence,
                revision=state.revision,
                light_weights=state.light_weights,
                object_poses=state.object_poses,
            )
        )
        for client in self._clients:
            try:
                client.session.offer_control(self._control)
            except SessionError as error:
                client.fail(error)
            client.wake.set()

    def _take_atlas(self, tiles: AtlasTiles) -> None:
        last = self._atlas
        size = (tiles.width, tiles.height, tiles.room_revision)
        if last is None or (last.width, last.height, last.room_revision) != size:
            self._atlas_words = np.zeros((tiles.height, tiles.width), np.uint32)
            grid = (tiles.height // ATLAS_TILE_SIZE, tiles.width // ATLAS_TILE_SIZE)
            self._atlas_known = np.zeros(grid, np.bool_)
        assert self._atlas_words is not None
        assert self._atlas_known is not None
        self._atlas = tiles
        paste_tiles(self._atlas_words, tiles)
        self._atlas_known[tiles.positions[:, 1], tiles.positions[:, 0]] = True
        for client in self._clients:
            if client.session.wants_atlas:
                client.session.offer_atlas(tiles)
                client.wake.set()

    def _notice_atlas_wish(self, before: bool) -> None:
        if self.on_atlas_wanted is not None and self.atlas_wanted != before:
            self.on_atlas_wanted(not before)

"""One websocket: a task that reads, a task that writes, a look at the clock. Nobody waits for another client."""

from __future__ import annotations

import asyncio
import contextlib
import time

import structlog
from starlette.responses import PlainTextResponse
from starlette.websockets import WebSocket, WebSocketDisconnect

from nearfield_protocol.codec import SetLightWeight, SetObjectPose, Subscribe
from nearfield_protocol.errors import SessionError
from nearfield_protocol.layout import CloseCode
from nearfield_protocol.session import negotiate, short_reason
from nearfield_server.gateway.hub import Client, LightHub
from nearfield_server.gateway.ports import ControlSink
from nearfield_server.gateway.security import deny_websocket

_CLOSE_TIMEOUT_S = 1.0
_log = structlog.get_logger("nearfield.gateway")


async def serve_websocket(websocket: WebSocket, hub: LightHub, controls: ControlSink) -> None:
    """Run one connection from handshake to end."""
    handshake = negotiate(websocket.scope.get("subprotocols", []))
    if handshake.subprotocol is None:
        response = PlainTextResponse(handshake.reason + "\n", status_code=400)
        await deny_websocket(response, websocket.receive, websocket.send)
        return
    await websocket.accept(subprotocol=handshake.subprotocol)
    if handshake.close_code is not None:
        await _close(websocket, hub, SessionError(handshake.close_code, handshake.reason))
        return
    if hub.is_full:
        reason = (
            f"{hub.max_clients} tablets are connected, as many as this server allows: close one and try again"
        )
        await _close(websocket, hub, SessionError(CloseCode.SERVER_FULL, reason))
        return
    client = hub.join()
    try:
        await _run_session(websocket, hub, controls, client)
    finally:
        hub.leave(client)


async def _run_session(websocket: WebSocket, hub: LightHub, controls: ControlSink, client: Client) -> None:
    tasks = [
        asyncio.create_task(_read(websocket, hub, controls, client)),
        asyncio.create_task(_write(websocket, hub, client)),
        asyncio.create_task(_watch(hub, client)),
    ]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        error = task.exception()
        if isinstance(error, SessionError):
            await _close(websocket, hub, error)
            return
        # The peer is gone: nothing to say to it. Anything else is a bug and propagates.
        if error is not None and not isinstance(error, (WebSocketDisconnect, OSError)):
            raise error


async def _read(websocket: WebSocket, hub: LightHub, controls: ControlSink, client: Client) -> None:
    while True:
        event = await websocket.receive()
        if event["type"] == "websocket.disconnect":
            return
        data = event.get("bytes")
        wanted = hub.atlas_wanted
        message = client.session.receive(event.get("text") or "" if data is None else data, time.monotonic())
        match message:
            case Subscribe():
                hub.subscribe(client, message, wanted)
            case SetLightWeight() | SetObjectPose():
                hub.metrics.control_requests.inc()
                controls.request(message)
            case _:
                # An acknowledgement may have made room for the next packet.
                client.wake.set()


async def _write(websocket: WebSocket, hub: LightHub, client: Client) -> None:
    while True:
        await client.wake.wait()
        client.wake.clear()
        if client.fault is not None:
            raise client.fault
        while (data := client.session.next_message(time.monotonic())) is not None:
            await websocket.send_bytes(data)
            hub.metrics.sent_messages.inc()
            hub.metrics.sent_bytes.inc(len(data))


async def _watch(hub: LightHub, client: Client) -> None:
    period = min(0.5, hub.limits.ack_timeout / 4)
    while True:
        await asyncio.sleep(period)
        # A writer that is stuck in a full socket cannot notice the fault itself.
        if client.fault is not None:
            raise client.fault
        client.session.check(time.monotonic())


async def _close(websocket: WebSocket, hub: LightHub, error: SessionError) -> None:
    hub.metrics.closed.labels(str(int(error.close_code))).inc()
    _log.info("connection closed", code=int(error.close_code), reason=error.reason)
    # To a client that does not read, the close frame cannot be sent; the kernel's TCP_USER_TIMEOUT ends that connection.
    with contextlib.suppress(TimeoutError, WebSocketDisconnect, OSError, RuntimeError):
        async with asyncio.timeout(_CLOSE_TIMEOUT_S):
            await websocket.close(int(error.close_code), short_reason(error.reason))

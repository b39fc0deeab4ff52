"""Tablets without a picture: websockets that take every light packet and acknowledge it, in a process of their own.

`python -m nearfield_server.benchmark.websocket_clients URL N` prints "ready" when all have light, and runs until its input ends.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence

from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from nearfield_protocol.codec import LightPacket
from nearfield_protocol.layout import SUBPROTOCOL
from nearfield_protocol.session import ClientSession


async def _tablet(url: str, has_light: asyncio.Event) -> None:
    session = ClientSession()
    async with connect(
        url, subprotocols=[Subprotocol(SUBPROTOCOL)], compression=None, proxy=None
    ) as websocket:
        session.subscribe()
        while True:
            for data in session.take_outgoing():
                await websocket.send(data)
            try:
                received = await websocket.recv(decode=False)
            except ConnectionClosed:
                return
            if isinstance(session.receive(received), LightPacket):
                has_light.set()


async def _run(url: str, count: int) -> None:
    lit = [asyncio.Event() for _ in range(count)]
    tablets = [asyncio.create_task(_tablet(url, event)) for event in lit]
    await asyncio.gather(*(event.wait() for event in lit))
    print("ready", flush=True)  # noqa: T201 - the parent waits for this line
    await asyncio.to_thread(sys.stdin.read)
    for tablet in tablets:
        tablet.cancel()
    await asyncio.gather(*tablets, return_exceptions=True)


def main(arguments: Sequence[str]) -> None:
    """Connect as many clients as asked for."""
    url, count = arguments
    asyncio.run(_run(url, int(count)))


if __name__ == "__main__":
    main(sys.argv[1:])

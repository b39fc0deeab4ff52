"""How late the light is: from a captured picture to the packet on the socket, and from a lamp's switch to a pixel on the screen.

Both are measured on the whole service with all its processes, from outside: capture times travel in the packets and are of
CLOCK_MONOTONIC, as is the clock of the one who receives them; the browser measures with its own.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from websockets.sync.client import connect

from nearfield_protocol.codec import LightPacket
from nearfield_protocol.layout import SUBPROTOCOL
from nearfield_protocol.session import ClientSession
from nearfield_server.benchmark.client_page import RASTERISERS
from nearfield_server.benchmark.client_scene import LAB
from nearfield_server.benchmark.running_service import running_service
from nearfield_server.errors import ServiceError
from nearfield_server.evaluation.browser import QUIET_ARGUMENTS, find_browser
from nearfield_server.scene.bundle import load_bundle

Progress = Callable[[str], None]

FRAME_RATE: Final = 10.0
"""Of the cameras while packets are timed: below what two busy cores can serve, so that no queue is measured."""
_WARM_UP_PACKETS: Final = 10
PATIENCE_S: Final = 120.0
_QUIET_MS: Final = 2500
"""Without a changed pixel the picture is at rest: longer than a frame of a software renderer on a busy machine."""
_WIDTH: Final = 640
_HEIGHT: Final = 480

# Every frame that the page draws is read back at once, while its drawing buffer still holds it. What is compared is what is shown:
# eight bits per channel of the whole canvas. In the free view nothing but light from the server changes a picture; the simulated
# camera pictures of tablet views follow the switch at once, as a real tablet's would.
_WATCH_FRAMES: Final = """
(() => {
  const request = window.requestAnimationFrame.bind(window)
  const copy = document.createElement('canvas').getContext('2d', { willReadFrequently: true })
  let before = null
  const watch = { changedMs: performance.now(), waiting: null }
  window.nearfieldWatch = watch
  const look = () => {
    const canvas = document.querySelector('canvas.picture')
    if (!canvas || canvas.width === 0) {
      return
    }
    copy.canvas.width = canvas.width
    copy.canvas.height = canvas.height
    copy.drawImage(canvas, 0, 0)
    const pixels = new Uint32Array(copy.getImageData(0, 0, canvas.width, canvas.height).data.buffer)
    if (pixels.every((value) => value === pixels[0])) {
      return // nothing was drawn: the buffer is empty
    }
    const isResized = before === null || before.length !== pixels.length
    const isChanged = isResized || pixels.some((value, at) => value !== before[at])
    before = pixels
    if (isChanged) {
      watch.changedMs = performance.now()
    }
    // Another resolution is no other light.
    if (isChanged && !isResized) {
      watch.waiting?.(watch.changedMs)
    }
  }
  window.requestAnimationFrame = (callback) => request((nowMs) => { callback(nowMs); look() })
})()
"""
_IS_QUIET: Final = "(ms) => performance.now() - window.nearfieldWatch.changedMs > ms"
_SWITCH: Final = """
([lamp, weight]) => new Promise((resolve) => {
  const startMs = performance.now()
  window.nearfieldWatch.waiting = (changedMs) => {
    window.nearfieldWatch.waiting = null
    resolve(changedMs - startMs)
  }
  window.nearfield.setLightWeight(lamp, weight)
})
"""


def measure_latency(quick: bool, progress: Progress, *, room: Path | None = None) -> dict[str, Any]:
    """Measure both latencies.

    Args:
        quick: fewer packets and switches.
        progress: told in words what is being done.
        room: an evaluation bundle with lighting sequences; default: the room that comes with the package.

    Returns:
        {`capture_to_packet_ms`: from the capture of the oldest picture that took part to the arrival of the packet on loopback, under
        light that changes in every picture; `switch_to_pixel_ms`: from the request of the page to the first pixel that differs}, each
        {`p50`, `p99`, `count`}, milliseconds. Simulated cameras form their pictures after the time of capture: that is included.

    Raises:
        ServiceError: the service or the browser fails, or playwright is missing.
    """
    folder = LAB if room is None else room
    progress(f"latency: packets of {folder.name} at {FRAME_RATE:g} pictures per second")
    sequence = liveliest_sequence(folder)
    with running_service(folder, "--rate", f"{FRAME_RATE:g}", "--sequence", sequence) as url:
        packets = packet_latencies(url, 50 if quick else 220)
    progress("latency: from the lamp's switch to the pixel")
    with running_service(folder) as url:
        switches = switch_latencies(url, 5 if quick else 20)
    return {"capture_to_packet_ms": summarise(packets), "switch_to_pixel_ms": summarise(switches)}


def summarise(latencies_ms: Sequence[float]) -> dict[str, float]:
    """Median and 99th percentile, milliseconds, and how many there were."""
    p50, p99 = np.percentile(latencies_ms, [50, 99])
    return {"p50": float(p50), "p99": float(p99), "count": len(latencies_ms)}


def liveliest_sequence(folder: Path) -> str:
    """Name of the lighting sequence of a bundle in which the most frames differ from the one before.

    Raises:
        ServiceError: the bundle has none.
    """
    changes = {
        sequence.name: float(np.any(np.diff(sequence.weights, axis=0) != 0.0, axis=1).mean())
        for sequence in load_bundle(folder).sequences
    }
    if not changes:
        raise ServiceError(f"{folder}: latency needs a room with a lighting sequence, and this one has none")
    return max(changes, key=lambda name: changes[name])


def packet_latencies(url: str, count: int) -> list[float]:
    """Milliseconds from capture to arrival of `count` light packets, after some to warm up.

    Raises:
        ServiceError: packets stop coming.
    """
    latencies: list[float] = []
    session = ClientSession()
    address = url.replace("http", "ws", 1) + "ws"
    with connect(address, subprotocols=[SUBPROTOCOL], compression=None, proxy=None) as socket:  # type: ignore[list-item]
        end_s = time.monotonic() + PATIENCE_S
        while len(latencies) < count + _WARM_UP_PACKETS:
            data = socket.recv(timeout=PATIENCE_S)
            arrived_ns = time.monotonic_ns()
            message = session.receive(bytes(data))  # type: ignore[arg-type]
            for answer in session.take_outgoing():
                socket.send(answer)
            if isinstance(message, LightPacket):
                latencies.append((arrived_ns - message.timestamp_ns) * 1e-6)
                end_s = time.monotonic() + PATIENCE_S
            elif time.monotonic() > end_s:
                raise ServiceError(f"no light packet for {PATIENCE_S:.0f} s under changing light")
    return latencies[_WARM_UP_PACKETS:]


def switch_latencies(url: str, count: int) -> list[float]:
    """Milliseconds from switching the first lamp in the page to the first pixel that differs, `count` times.

    Raises:
        ServiceError: playwright or the browser is missing, or the page fails; carries what the page said.
    """
    try:
        from playwright.sync_api import Error, sync_playwright
    except ModuleNotFoundError as error:
        raise ServiceError("timing the page needs playwright; install nearfield[evaluate]") from error
    arguments = [
        *QUIET_ARGUMENTS,
        *RASTERISERS["llvmpipe"],
        *(["--no-sandbox"] if os.geteuid() == 0 else []),
    ]
    said: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_browser(), headless=True, args=arguments)
        try:
            page = browser.new_page(viewport={"width": _WIDTH, "height": _HEIGHT}, device_scale_factor=1)
            page.set_default_timeout(PATIENCE_S * 1e3)
            page.on("pageerror", lambda error: said.append(str(error)))
            page.add_init_script(_WATCH_FRAMES)
            page.goto(url)
            page.wait_for_function("() => window.nearfield !== undefined")
            page.evaluate("() => window.nearfield.ready")
            page.evaluate("() => window.nearfield.setView('free')")
            page.wait_for_function("() => window.nearfield.state().sequence !== null")
            return [_switch(page, number) for number in range(count)]
        except Error as error:
            reason = "; ".join([error.message.splitlines()[0], *said[:5]])
            raise ServiceError(f"the page failed in the browser: {reason}") from error
        finally:
            browser.close()


def _switch(page: Any, number: int) -> float:
    """Turn the first lamp off and on by turns, each time after the picture came to rest."""
    page.wait_for_function(_IS_QUIET, arg=_QUIET_MS, polling=100)
    return float(page.evaluate(_SWITCH, [0, float(number % 2)]))

"""Drives the real client in headless Chromium and takes its linear pictures."""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import ServiceError

BROWSER_NAMES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome")
BROWSER_VARIABLE = "NEARFIELD_CHROMIUM"
# The software rasteriser of Chromium itself: the same pictures on every machine, with or without a GPU.
_SWIFTSHADER = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
QUIET_ARGUMENTS = (
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
"""A browser that talks to nobody but the page's server."""
# Compiling shaders in software takes seconds on an idle machine and minutes on a busy one.
_TIMEOUT_MS = 300_000


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientPictures:
    """Linear composites (H, W, 4) float32 in the order of the request, and the browser's version."""

    composites: tuple[NDArray[np.float32], ...]
    browser: str


def find_browser() -> str:
    """Path of a Chromium.

    Raises:
        ServiceError: there is none.
    """
    chosen = os.environ.get(BROWSER_VARIABLE)
    for name in (chosen,) if chosen else BROWSER_NAMES:
        path = shutil.which(name)
        if path is not None:
            return path
    raise ServiceError(
        f"no browser found (looked for {chosen or ', '.join(BROWSER_NAMES)}); install the Debian package `chromium`, "
        f"set {BROWSER_VARIABLE} to its path, or evaluate with --no-views"
    )


class ClientPage:
    """The client in evaluation mode, with its light and its renderer at the caller's command."""

    def __init__(self, browser: Any, page: Any) -> None:
        self._browser, self._page = browser, page

    @property
    def browser_name(self) -> str:
        """Name and version."""
        return f"Chromium {self._browser.version}"

    def devtools_session(self) -> Any:
        """A CDP session of the whole browser; detach it after use."""
        return self._browser.new_browser_cdp_session()

    def wait_for_light(self, sequence: int) -> None:
        """Return once the light of a packet from the server, or a newer one, is shown."""
        self._page.evaluate("(sequence) => window.nearfield.waitForLight(sequence)", sequence)

    def apply_light(self, packet: bytes) -> None:
        """Show the light of a packet as if it had come from the server.

        Raises:
            ServiceError: the client takes the packet for an old one: its sequence must grow.
        """
        data = base64.b64encode(packet).decode("ascii")
        if not self._page.evaluate("(data) => window.nearfield.applyLightPacket(data)", data):
            raise ServiceError(
                "the client refused a light packet as out of date; number packets upwards from the first"
            )

    def change_method(self, settings: Mapping[str, bool]) -> None:
        """Switch parts of the renderer (`MethodSettings` of the client)."""
        self._page.evaluate("(settings) => window.nearfield.changeMethod(settings)", dict(settings))

    def composite(
        self, view_index: int, *, full_quality: bool = True, scale: float = 1.0
    ) -> NDArray[np.float32]:
        """Linear composite of a tablet view with the newest light: (H, W, 4), row 0 on top.

        Args:
            view_index: which view.
            full_quality: as `nearfield evaluate` judges it, else as a tablet draws it.
            scale: of the picture's size against that of the view's calibration.
        """
        quality = {"fullQuality": full_quality, "scale": scale}
        answer = self._page.evaluate(
            "([index, quality]) => window.nearfield.renderViewComposite(index, quality)",
            [view_index, quality],
        )
        return decode_picture(answer)

    def draw_frames(self, view_index: int, packets: Sequence[bytes]) -> None:
        """Draw one frame of a tablet view in live quality per packet, and wait until all are drawn."""
        data = [base64.b64encode(packet).decode("ascii") for packet in packets]
        self._page.evaluate(
            """async ([index, packets]) => {
              for (const packet of packets) {
                window.nearfield.applyLightPacket(packet)
                await window.nearfield.drawViewFrame(index)
              }
            }""",
            [view_index, data],
        )


@contextmanager
def open_client(url: str, rasteriser: Sequence[str] = _SWIFTSHADER) -> Iterator[ClientPage]:
    """Open the page in evaluation mode, ready to draw, and close the browser at the end.

    Args:
        url: of the page, without query.
        rasteriser: arguments that choose what Chromium draws with.

    Raises:
        ServiceError: playwright or the browser is missing, or the page fails; carries what the page said.
    """
    try:
        from playwright.sync_api import Error, sync_playwright
    except ModuleNotFoundError as error:
        raise ServiceError(
            "rendering views needs playwright; install nearfield[evaluate], or evaluate with --no-views"
        ) from error
    arguments = [*QUIET_ARGUMENTS, *rasteriser, *(["--no-sandbox"] if os.geteuid() == 0 else [])]
    said: list[str] = []
    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(
                executable_path=find_browser(), headless=True, args=arguments
            )
            try:
                page = browser.new_page(viewport={"width": 960, "height": 540}, device_scale_factor=1)
                page.set_default_timeout(_TIMEOUT_MS)
                page.on(
                    "console", lambda message: said.append(message.text) if message.type == "error" else None
                )
                page.on("pageerror", lambda error: said.append(str(error)))
                page.goto(f"{url}?mode=evaluate")
                page.wait_for_function("() => window.nearfield !== undefined")
                page.evaluate("() => window.nearfield.ready")
                yield ClientPage(browser, page)
            finally:
                browser.close()
        except Error as error:
            reason = "; ".join([error.message.splitlines()[0], *said[:5]])
            raise ServiceError(f"the client failed in the browser: {reason}") from error


def take_pictures(url: str, view_indices: Sequence[int], sequence: int) -> ClientPictures:
    """Open the page in evaluation mode and render views with the light of one packet.

    Args:
        url: of the page, without query.
        view_indices: which views.
        sequence: of the light packet to wait for.

    Raises:
        ServiceError: see `open_client`.
    """
    with open_client(url) as client:
        client.wait_for_light(sequence)
        pictures = tuple(client.composite(index) for index in view_indices)
        return ClientPictures(composites=pictures, browser=client.browser_name)


def decode_picture(answer: dict[str, Any]) -> NDArray[np.float32]:
    """`{width, height, data}` with base64 float32 RGBA, row 0 on top, to (height, width, 4).

    Raises:
        ServiceError: the size does not fit the data, or values are not finite.
    """
    width, height = int(answer["width"]), int(answer["height"])
    values = np.frombuffer(base64.b64decode(answer["data"]), "<f4")
    if values.size != 4 * width * height:
        raise ServiceError(
            f"the client returned {values.size} numbers for a picture of {width} x {height}, expected {4 * width * height}; "
            "build the client again (npm run build in client_web)"
        )
    if not np.isfinite(values).all():
        bad = int(np.count_nonzero(~np.isfinite(values)))
        raise ServiceError(
            f"the client returned a picture with {bad} values that are not finite; its renderer has a fault"
        )
    return values.reshape(height, width, 4)

"""Drives the real client in headless Chromium and takes its linear pictures."""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import ServiceError

BROWSER_NAMES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome")
BROWSER_VARIABLE = "NEARFIELD_CHROMIUM"
# The software rasteriser of Chromium itself: the same pictures on every machine, with or without a GPU.
_ARGUMENTS = (
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
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


def take_pictures(url: str, view_indices: Sequence[int], sequence: int) -> ClientPictures:
    """Open the page in evaluation mode and render views with the light of one packet.

    Args:
        url: of the page, without query.
        view_indices: which views.
        sequence: of the light packet to wait for.

    Raises:
        ServiceError: playwright or the browser is missing, or the page fails; carries what the page said.
    """
    try:
        from playwright.sync_api import Error, sync_playwright
    except ModuleNotFoundError as error:
        raise ServiceError(
            "rendering views needs playwright; install nearfield[evaluate], or evaluate with --no-views"
        ) from error
    arguments = [*_ARGUMENTS, *(["--no-sandbox"] if os.geteuid() == 0 else [])]
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
                page.evaluate("(sequence) => window.nearfield.waitForLight(sequence)", sequence)
                pictures = tuple(
                    decode_picture(
                        page.evaluate("(index) => window.nearfield.renderViewComposite(index)", index)
                    )
                    for index in view_indices
                )
                return ClientPictures(composites=pictures, browser=f"Chromium {browser.version}")
            finally:
                browser.close()
        except Error as error:
            reason = "; ".join([error.message.splitlines()[0], *said[:5]])
            raise ServiceError(f"the client failed in the browser: {reason}") from error


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

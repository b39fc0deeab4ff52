"""The benchmark page in headless Chromium: variants are made, drawn and timed from here."""

from __future__ import annotations

import base64
import contextlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from nearfield_server.benchmark.client_scene import ClientScene
from nearfield_server.benchmark.gpu_process import process_ids_of, thread_time_ns
from nearfield_server.errors import ServiceError
from nearfield_server.evaluation.browser import find_browser
from nearfield_server.gateway.app import create_app
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.ports import NoControls
from nearfield_server.gateway.server import serve_in_thread

BUILT_BENCH: Final = Path(__file__).resolve().parents[1] / "static_bench"
"""Where `make setup` builds the benchmark page in a checkout."""

RASTERISERS: Final[Mapping[str, tuple[str, ...]]] = {
    "llvmpipe": ("--use-gl=angle", "--use-angle=gl-egl", "--ignore-gpu-blocklist"),
    "swiftshader": ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
}
_ARGUMENTS: Final = (
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
# Compiling sixteen shadowed lights in software takes seconds on an idle machine and minutes on a busy one.
_TIMEOUT_MS: Final = 300_000


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameCost:
    """Cost of one frame, ms: CPU of the browser's GPU process, CPU of the page's process, wall."""

    gpu_cpu_ms: float
    page_cpu_ms: float
    wall_ms: float


class BenchPage:
    """The open page."""

    def __init__(self, page: Any, session: Any) -> None:
        self._page = page
        self._gpu_processes = process_ids_of(session, "GPU")
        # One of them runs the page; the others idle.
        self._page_processes = process_ids_of(session, "renderer")

    def create(
        self,
        name: str,
        maker: str,
        packet: bytes,
        exposure: float,
        *,
        shadows: bool = True,
        lights: bool = True,
        growth: Mapping[str, int] | None = None,
    ) -> dict[str, int]:
        """Make a variant; what it needs is compiled when it first draws.

        Args:
            name: of the variant from now on.
            maker: which renderer, a key of MAKERS in client_web/bench/main.ts.
            packet: light packet.
            exposure: factor on linear radiance.
            shadows: whether lights cast shadows.
            lights: whether there is light.
            growth: changes to the scene, see client_web/bench/growth.ts.

        Returns:
            What it draws: number of `vals` and of `triangles` of virtual objects.
        """
        drawing = {"shadows": shadows, "lights": lights}
        data = base64.b64encode(packet).decode()
        return dict(self._call("create", name, maker, data, exposure, drawing, dict(growth or {})))

    def measure(self, name: str, kind: str, frames: int) -> FrameCost:
        """Draw `frames` frames and wait for each; the mean cost of one."""
        self._call("prepare", name, kind)
        gpu, page = _cpu_ms(self._gpu_processes), _cpu_ms(self._page_processes)
        wall = self._call("run", name, kind, frames)["wallMs"]
        return FrameCost(
            gpu_cpu_ms=(_cpu_ms(self._gpu_processes) - gpu) / frames,
            page_cpu_ms=(_cpu_ms(self._page_processes) - page) / frames,
            wall_ms=wall / frames,
        )

    def passes(self, name: str) -> list[dict[str, Any]]:
        """Passes of the last frame of a variant of ours, each with `name` and `ran`."""
        return list(self._call("passes", name))

    def picture(self, name: str) -> bytes:
        """PNG of a frame."""
        return base64.b64decode(self._call("picture", name).partition(",")[2])

    def remove(self, name: str) -> None:
        """Give a variant's context back."""
        self._call("remove", name)

    def _call(self, function: str, *arguments: object) -> Any:
        return self._page.evaluate("([name, args]) => bench[name](...args)", [function, list(arguments)])


def _cpu_ms(process_ids: tuple[int, ...]) -> float:
    return 1e-6 * sum(thread_time_ns(each) for each in process_ids)


@contextlib.contextmanager
def open_bench_page(
    scene: ClientScene, rasteriser: str, width: int, height: int, *, static_dir: Path = BUILT_BENCH
) -> Iterator[BenchPage]:
    """Serve the scene, start a browser and open the page.

    Args:
        scene: what is drawn.
        rasteriser: a key of `RASTERISERS`.
        width: of the pictures, pixels.
        height: of the pictures, pixels.
        static_dir: the built page.

    Raises:
        ServiceError: the page is not built, playwright or a browser is missing, or the page fails; carries what the page said.
    """
    require_built_page(static_dir)
    try:
        from playwright.sync_api import Error, sync_playwright
    except ModuleNotFoundError as error:
        raise ServiceError("timing the client needs playwright; install nearfield[evaluate]") from error
    arguments = [*_ARGUMENTS, *RASTERISERS[rasteriser], *(["--no-sandbox"] if os.geteuid() == 0 else [])]
    app = create_app(
        scene.served.description, LightHub(), NoControls(), static_dir, assets=scene.served.assets
    )
    said: list[str] = []
    with serve_in_thread(app) as url, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_browser(), headless=True, args=arguments)
        try:
            page = browser.new_page(viewport={"width": 320, "height": 200})
            page.set_default_timeout(_TIMEOUT_MS)
            page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
            page.on("pageerror", lambda error: said.append(str(error)))
            page.goto(url)
            page.wait_for_function("() => window.bench !== undefined")
            page.evaluate("([w, h]) => bench.load(w, h)", [width, height])
            yield BenchPage(page, browser.new_browser_cdp_session())
        except Error as error:
            reason = "; ".join([error.message.splitlines()[0], *said[:5]])
            raise ServiceError(f"the client benchmark failed in the browser: {reason}") from error
        finally:
            browser.close()


def require_built_page(static_dir: Path = BUILT_BENCH) -> None:
    """Refuse in words when the page is missing.

    Raises:
        ServiceError: says how to build it.
    """
    if not (static_dir / "index.html").is_file():
        raise ServiceError(
            f"the client benchmark is not built ({static_dir / 'index.html'} is missing; it is no part of the wheel). "
            "In the source tree, run `make setup`, or `npm ci && npm run build:bench` in client_web"
        )

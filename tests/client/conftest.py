"""The real renderer in headless Chromium, without server and app, fed with synthetic scenes.

`client_web/vite.harness.config.ts` bundles `src/render/testHarness.ts` into a temporary folder; nothing of it is shipped.
"""

from __future__ import annotations

import base64
import functools
import http.server
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

CLIENT = Path(__file__).resolve().parents[2] / "client_web"
ARGUMENTS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    # Mesa's software rasteriser: two to three times faster than Chromium's own.
    "--use-gl=angle",
    "--use-angle=gl-egl",
    "--ignore-gpu-blocklist",
]


class _QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


class Harness:
    """Calls into the page of the renderer, and builders of synthetic scenes."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.size = (1, 1)

    def call(self, name: str, *arguments: object) -> Any:
        return self.page.evaluate("([name, args]) => harness[name](...args)", [name, list(arguments)])

    def create(self, scene: dict[str, Any], width: int, height: int, **options: object) -> None:
        self.call("create", scene, options)
        self.call("setSize", width, height)
        self.size = (width, height)
        self.call("setView", 0)

    def picture(self) -> NDArray[np.float32]:
        """Linear RGBA (H, W, 4), row 0 on top."""
        width, height = self.size
        data = base64.b64decode(self.call("picture"))
        return np.frombuffer(data, np.float32).reshape(height, width, 4)

    @staticmethod
    def box(low: list[float], high: list[float], albedo: list[float], *, inward: bool) -> dict[str, Any]:
        """Six faces, seen from inside (a room) or from outside (furniture)."""
        positions, normals, indices = [], [], []
        corner = np.array([low, high], float)
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for side in range(2):
                normal = np.zeros(3)
                normal[axis] = (2 * side - 1) * (-1 if inward else 1)
                first = len(positions)
                for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    p = np.zeros(3)
                    p[axis], p[u], p[v] = corner[side, axis], corner[a, u], corner[b, v]
                    positions.append(p)
                    normals.append(normal)
                # Counter-clockwise about +axis as built, so the other way round about -axis.
                order = [0, 1, 2, 0, 2, 3] if normal[axis] > 0 else [0, 2, 1, 0, 3, 2]
                indices += [first + i for i in order]
        return {
            "positions": np.ravel(positions).tolist(),
            "normals": np.ravel(normals).tolist(),
            "indices": indices,
            "albedo": albedo * len(positions),
        }

    @staticmethod
    def join(*parts: dict[str, Any]) -> dict[str, Any]:
        result: dict[str, Any] = {"positions": [], "normals": [], "indices": [], "albedo": []}
        for part in parts:
            first = len(result["positions"]) // 3
            result["indices"] += [first + i for i in part["indices"]]
            for key in ("positions", "normals", "albedo"):
                result[key] += part[key]
        return result

    @staticmethod
    def floor(half: float = 4.0, albedo: float = 0.5) -> dict[str, Any]:
        """The square [-half, half]^2 at y = 0, facing up."""
        return {
            "positions": [-half, 0, -half, -half, 0, half, half, 0, half, half, 0, -half],
            "normals": [0, 1, 0] * 4,
            "indices": [0, 1, 2, 0, 2, 3],
            "albedo": [albedo] * 12,
        }

    @staticmethod
    def sphere(
        centre: list[float], radius: float, albedo: float = 0.6, rings: int = 48, **more: object
    ) -> dict[str, Any]:
        """A virtual sphere; its own axes are at its centre."""
        theta = np.linspace(0, np.pi, rings + 1)[:, None]
        phi = np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False)[None]
        normals = np.stack(
            np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)), -1
        ).reshape(-1, 3)
        indices = []
        for i in range(rings):
            for j in range(2 * rings):
                a, b = i * 2 * rings + j, i * 2 * rings + (j + 1) % (2 * rings)
                indices += [a, b, b + 2 * rings, a, b + 2 * rings, a + 2 * rings]
        pose = np.eye(4)
        pose[:3, 3] = centre
        return {
            "positions": (radius * normals).ravel().tolist(),
            "normals": normals.ravel().tolist(),
            "indices": indices,
            "albedo": [albedo] * 3,
            "worldFromObject": pose.ravel().tolist(),
            "centre": [0, 0, 0],
            "radius": radius,
            **more,
        }

    @staticmethod
    def view(eye: list[float], target: list[float], width: int, height: int, focal: float) -> dict[str, Any]:
        """A pinhole camera (OpenCV axes) that looks from `eye` to `target`."""
        forward = np.subtract(target, eye, dtype=float)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 1, 0] if abs(forward[1]) < 0.99 else [0, 0, -1])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, eye
        return {
            "width": width,
            "height": height,
            "fx": focal,
            "fy": focal,
            "cx": (width - 1) / 2,
            "cy": (height - 1) / 2,
            "worldFromCamera": pose.ravel().tolist(),
        }

    @staticmethod
    def floor_points(view: dict[str, Any]) -> NDArray[np.float64]:
        """Where the ray of every pixel meets y = 0: (H, W, 3)."""
        pose = np.reshape(view["worldFromCamera"], (4, 4))
        x, y = np.meshgrid(np.arange(view["width"]), np.arange(view["height"]))
        rays = np.stack(
            [(x - view["cx"]) / view["fx"], (y - view["cy"]) / view["fy"], np.ones_like(x, float)], -1
        )
        rays = rays @ pose[:3, :3].T
        return pose[:3, 3] - rays * (pose[1, 3] / rays[..., 1:2])

    @staticmethod
    def val(
        position: list[float], normal: list[float], radius: float, radiance: float | list[float]
    ) -> dict[str, Any]:
        area = np.pi * radius**2
        unit = np.asarray(normal, float) / np.linalg.norm(normal)
        intensity = np.broadcast_to(np.asarray(radiance, float) * area, (3,))
        return {
            "position": position,
            "normal": unit.tolist(),
            "radiantIntensity": intensity.tolist(),
            "area": area,
        }


@pytest.fixture(scope="session")
def harness_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The harness, built once."""
    folder = tmp_path_factory.mktemp("harness")
    tools = Path(sys.executable).parent
    npx = shutil.which("npx", path=str(tools)) or shutil.which("npx")
    if npx is None or not (CLIENT / "node_modules").is_dir():
        pytest.fail("the client cannot be built: install Node 22 or later and run `npm ci` in client_web")
    command = [npx, "vite", "build", "--config", "vite.harness.config.ts", "--outDir", str(folder)]
    built = subprocess.run(
        command,
        cwd=CLIENT,
        env={"PATH": f"{tools}:/usr/bin:/bin", "HOME": str(Path.home())},
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    return folder


# Servers and browsers end with their module: a running driver keeps an event loop that other tests must not meet.
@pytest.fixture(scope="module")
def harness_address(harness_folder: Path) -> Iterator[str]:
    handler = functools.partial(_QuietHandler, directory=str(harness_folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/harness.html"
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api")
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.fail("no Chromium found: install it (`apt-get install chromium`)")
    with sync_api.sync_playwright() as driver:
        instance = driver.chromium.launch(executable_path=path, headless=True, args=ARGUMENTS)
        yield instance
        instance.close()


@pytest.fixture
def harness(browser: Any, harness_address: str) -> Iterator[Harness]:
    page = browser.new_page(viewport={"width": 640, "height": 480})
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on(
        "console", lambda message: problems.append(message.text) if "GL_INVALID" in message.text else None
    )
    page.goto(harness_address)
    page.wait_for_function("window.harness !== undefined")
    yield Harness(page)
    page.close()
    assert problems == []

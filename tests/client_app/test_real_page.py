"""The page as it ships, with the real gateway and the shipped tiny room: pictures obey the laws of light."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nearfield_protocol.codec import (
    VAL_DTYPE,
    Encoding,
    LightPacket,
    SetLightWeight,
    SetObjectPose,
    encode_light_packet,
)
from nearfield_server.gateway.app import create_app
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.scene_builder import ServedScene, build_scene
from nearfield_server.gateway.server import serve_in_thread
from nearfield_server.scene.room_config import load_room
from nearfield_server.scene.room_model import load_room_mesh

pytest.importorskip("playwright")

from playwright.sync_api import Browser, Page, expect

pytestmark = pytest.mark.browser

ROOM = Path(__file__).parents[1] / "data" / "tiny_room"
# Software rendering on a busy machine: compiling the shaders alone takes long.
PATIENCE_MS = 120_000


@dataclass
class Service:
    """A gateway without cameras; the test decides what light there is."""

    url: str
    hub: LightHub
    room_revision: int
    requests: list[Any] = field(default_factory=list)
    sequence: int = 0

    def light(self, radiant_intensity: float) -> str:
        """Base64 of a packet with one lamp at the ceiling and no indirect light."""
        self.sequence += 1
        vals = np.zeros(4, VAL_DTYPE)
        vals["position"], vals["normal"], vals["area"] = (1.0, 1.53, 1.0), (0, -1, 0), 0.16
        vals["radiant_intensity"][0] = radiant_intensity
        packet = LightPacket(
            sequence=self.sequence,
            timestamp_ns=1,
            room_revision=self.room_revision,
            vals=vals,
            object_sh=np.zeros((1, 9, 3), np.float32),
            object_revisions=np.zeros(1, np.uint32),
            bounds_min=np.zeros(3, np.float32),
            bounds_size=np.full(3, 2.0, np.float32),
        )
        return base64.b64encode(encode_light_packet(packet, Encoding.PLAIN)).decode()


@pytest.fixture(scope="module")
def served_scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedScene]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NEARFIELD_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        room = load_room(ROOM)
        yield build_scene(room, load_room_mesh(room.model_path), 1, preset="preview")


@pytest.fixture
def service(served_scene: ServedScene, real_page_dir: Path) -> Iterator[Service]:
    hub = LightHub()
    service = Service("", hub, served_scene.description.room.revision)

    class Controls:
        def request(self, request: Any) -> None:
            service.requests.append(request)

    app = create_app(served_scene.description, hub, Controls(), real_page_dir, assets=served_scene.assets)
    with serve_in_thread(app) as url:
        service.url = url
        yield service


@pytest.fixture
def visit(browser: Browser) -> Iterator[Callable[[str], tuple[Page, list[str]]]]:
    contexts = []

    def go(url: str) -> tuple[Page, list[str]]:
        context = browser.new_context(viewport={"width": 640, "height": 480}, has_touch=True)
        context.set_default_timeout(PATIENCE_MS)
        contexts.append(context)
        page = context.new_page()
        complaints: list[str] = []
        page.on(
            "console", lambda message: complaints.append(message.text) if message.type == "error" else None
        )
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(url)
        page.evaluate("window.nearfield.ready")
        # Light that a test applies would be lost if the session began after it.
        _until(page, lambda: page.evaluate("window.nearfield.state().connection") == "live")
        return page, complaints

    yield go
    for context in contexts:
        context.close()


def _composite(page: Page) -> NDArray[np.float32]:
    result = page.evaluate("window.nearfield.renderViewComposite(0)")
    values = np.frombuffer(base64.b64decode(result["data"]), "<f4")
    return values.reshape(result["height"], result["width"], 4)


def test_composites_are_linear_in_the_light(service: Service, visit: Callable[..., Any]) -> None:
    page, complaints = visit(f"{service.url}?mode=evaluate")

    def shown(radiant_intensity: float) -> NDArray[np.float32]:
        assert page.evaluate(
            "packet => window.nearfield.applyLightPacket(packet)", service.light(radiant_intensity)
        )
        page.evaluate("sequence => window.nearfield.waitForLight(sequence)", service.sequence)
        return _composite(page)

    # Weaker than the lamp of the pictures (1.44 W/sr in blue): a shadow cannot take more light than there is.
    dark, once, twice = shown(0.0), shown(0.5), shown(1.0)
    assert dark.shape == (54, 96, 4)
    on_object = dark[..., 3] > 0.999
    assert 50 < on_object.sum() < 2000
    assert dark[on_object][:, :3] == pytest.approx(0, abs=1e-6)
    # Rohmer et al. 2014, Eq. 12 and 13: both are affine in the radiant intensity; targets hold 11 significant bits.
    scale = np.abs(twice[..., :3]).max()
    np.testing.assert_allclose(twice + dark, 2 * once, atol=4e-3 * scale)
    lit = once[on_object][:, :3]
    assert lit.max() > 0.01
    # The ball has one albedo, so its colour is that of albedo under white light.
    mean = lit.mean(axis=0)
    assert mean / mean[0] == pytest.approx(np.array([0.7, 0.6, 0.3]) / 0.7, rel=0.02)
    assert complaints == []


def test_background_is_the_sum_of_its_lamps(service: Service, visit: Callable[..., Any]) -> None:
    page, complaints = visit(f"{service.url}?mode=evaluate")
    page.evaluate("packet => window.nearfield.applyLightPacket(packet)", service.light(0.0))

    def shown(first: float, second: float) -> NDArray[np.float32]:
        page.evaluate(f"window.nearfield.setLightWeight(0, {first})")
        page.evaluate(f"window.nearfield.setLightWeight(1, {second})")
        return _composite(page)

    first, second, both = shown(1, 0), shown(0, 1), shown(1, 1)
    room = both[..., 3] < 0.001
    assert room.sum() > 1000
    np.testing.assert_allclose(first[room] + second[room], both[room], rtol=4e-3, atol=1e-3)
    assert first[room][:, :3].mean() > 0.01
    assert complaints == []


def test_live_page_draws_sends_and_survives_a_lost_context(
    service: Service, visit: Callable[..., Any]
) -> None:
    page, complaints = visit(service.url)
    service.hub.publish_light(base64.b64decode(service.light(1.0)))
    page.evaluate("window.nearfield.waitForLight(1)")
    assert _brightness(page) > 10
    page.get_by_role("switch", name="Switch Ceiling").tap()
    _until(page, lambda: any(isinstance(each, SetLightWeight) for each in service.requests))
    pose = page.evaluate("window.nearfield.state().objectPoses[0]")
    pose[3] += 0.1
    page.evaluate("pose => window.nearfield.setObjectPose(0, pose)", pose)
    _until(page, lambda: any(isinstance(each, SetObjectPose) for each in service.requests))
    sent = next(each for each in service.requests if isinstance(each, SetObjectPose))
    assert sent.position == pytest.approx((1.05, 0.5, 0.95), abs=1e-5)
    assert complaints == []
    page.evaluate(
        "window.lose = document.querySelector('canvas').getContext('webgl2').getExtension('WEBGL_lose_context')"
    )
    page.evaluate("window.lose.loseContext()")
    expect(page.get_by_role("heading", name="The graphics unit gave up")).to_be_visible()
    page.evaluate("window.lose.restoreContext()")
    expect(page.get_by_role("heading", name="The graphics unit gave up")).to_be_hidden()
    _until(page, lambda: _brightness(page) > 10)


def test_a_dragged_object_takes_its_shadow_along(service: Service, visit: Callable[..., Any]) -> None:
    """The grabbed point stays under the pointer, and the server is told where the object stands in the end."""
    page, complaints = visit(service.url)

    def composite(radiant_intensity: float) -> NDArray[np.float32]:
        packet = service.light(radiant_intensity)
        page.evaluate("packet => window.nearfield.applyLightPacket(packet)", packet)
        page.evaluate("sequence => window.nearfield.waitForLight(sequence)", service.sequence)
        return _composite(page)

    background, before = composite(0.0), composite(0.5)
    width = before.shape[1]
    row, column = _centroid(before[..., 3])
    box = page.locator("canvas").bounding_box()
    assert box is not None
    scale = box["width"] / width
    x, y = box["x"] + (column + 0.5) * scale, box["y"] + (row + 0.5) * scale
    # Towards the side of the picture with more floor.
    shift = 12 if column < width / 2 else -12
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 0.5 * shift * scale, y, steps=3)
    page.mouse.move(x + shift * scale, y, steps=3)
    page.mouse.up()
    assert page.evaluate("window.nearfield.state().selectedObject") == 0
    after = _composite(page)
    assert after[round(row), round(column) + shift, 3] == 1
    moved = np.subtract(_centroid(after[..., 3]), (row, column))
    assert moved[1] == pytest.approx(shift, abs=2.5)
    shadows = [
        np.where(picture[..., 3] == 0, (background - picture)[..., :3].sum(-1), 0).clip(min=0)
        for picture in (before, after)
    ]
    travelled = np.subtract(_centroid(shadows[1]), _centroid(shadows[0]))
    assert travelled[1] * shift > 0
    assert abs(travelled[1]) > 4
    pose = page.evaluate("window.nearfield.state().objectPoses[0]")
    position = (pose[3], pose[7], pose[11])

    def is_told() -> bool:
        sent = [each for each in service.requests if isinstance(each, SetObjectPose)]
        return bool(sent) and sent[-1].position == pytest.approx(position, abs=1e-5)

    _until(page, is_told)
    assert complaints == []


def _centroid(weights: NDArray[np.float32]) -> tuple[float, float]:
    """Mean row and column, weighted."""
    rows, columns = np.indices(weights.shape)
    return float(np.average(rows, weights=weights)), float(np.average(columns, weights=weights))


def _brightness(page: Page) -> float:
    """Mean grey value of the picture on the screen, 0 to 255."""
    import cv2

    data = np.frombuffer(page.locator("canvas").screenshot(), np.uint8)
    return float(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE).mean())


def _until(page: Page, condition: Callable[[], bool]) -> None:
    for _ in range(400):
        if condition():
            return
        page.wait_for_timeout(50)
    raise AssertionError("the expected state was not reached")

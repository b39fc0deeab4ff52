"""The page in Chromium: it can be operated by touch, says what it does, and survives a lost connection."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from nearfield_protocol.codec import SetLightWeight, SetObjectPose

pytest.importorskip("playwright")

from playwright.sync_api import Browser, ConsoleMessage, Page, expect

pytestmark = pytest.mark.browser

TABLET = {"width": 1024, "height": 768}
PHONE = {"width": 390, "height": 844}
MIN_TARGET = 44


class OpenPage:
    """A page and every complaint of its console."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.complaints: list[str] = []
        page.on("console", self._note)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))

    def _note(self, message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)

    def state(self) -> dict[str, Any]:
        return self.page.evaluate("window.nearfield.state()")

    def wait_for(self, condition: str) -> None:
        """Wait until a JavaScript expression over `s`, the state of the page, holds."""
        # Not Page.wait_for_function: it needs eval, which the policy of the page forbids.
        _until(self.page, lambda: self.page.evaluate(f"(s => {condition})(window.nearfield.state())"))


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[..., OpenPage]]:
    contexts = []

    def visit(url: str, viewport: dict[str, int] = TABLET, *, ready: bool = True) -> OpenPage:
        context = browser.new_context(viewport=viewport, has_touch=True)
        context.set_default_timeout(15_000)
        contexts.append(context)
        opened = OpenPage(context.new_page())
        opened.page.goto(url)
        if ready:
            opened.page.evaluate("window.nearfield.ready")
        return opened

    yield visit
    for context in contexts:
        context.close()


@pytest.mark.parametrize("viewport", [TABLET, PHONE, {"width": 844, "height": 390}])
def test_everything_is_reachable_by_finger(gateway, open_page, viewport) -> None:
    opened = open_page(gateway.url, viewport)
    opened.wait_for("s.connection === 'live' && s.sequence === 1")
    page = opened.page
    for tab in ("Objects", "Picture", "Status", "Lamps"):
        page.get_by_role("tab", name=tab).tap()
        for target in page.locator(
            "button:visible, .switch:visible, .slider:visible, .segment-text:visible"
        ).all():
            box = target.bounding_box()
            assert box is not None
            label = target.get_attribute("aria-label") or target.inner_text()
            assert box["height"] >= MIN_TARGET, label
            assert box["width"] >= MIN_TARGET, label
            assert box["x"] >= 0, label
            assert box["x"] + box["width"] <= viewport["width"], label
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    picture = page.locator("canvas").bounding_box()
    assert picture is not None
    assert picture["width"] / picture["height"] == pytest.approx(960 / 540, rel=0.01)
    page.get_by_role("radio", name="Free orbit").check(force=True)
    before = _area(page)
    page.get_by_role("button", name="Hide controls").tap()
    _until(page, lambda: _area(page) > before)
    assert opened.complaints == []


def test_lamp_switch_sends_its_weight(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.connection === 'live'")
    opened.page.get_by_role("switch", name="Switch Ceiling light").tap()
    opened.wait_for("s.weights[0] === 0")
    _until(opened.page, lambda: _weights(gateway) == [(0, 0.0)])
    opened.page.get_by_role("switch", name="Switch Ceiling light").tap()
    _until(opened.page, lambda: _weights(gateway) == [(0, 0.0), (0, 1.0)])
    slider = opened.page.get_by_role("slider", name="Dimmer of Window")
    slider.fill("25")
    _until(opened.page, lambda: _weights(gateway)[-1] == (1, 0.25))
    assert opened.state()["weights"] == [1, 0.25]
    assert opened.complaints == []


def test_lamps_follow_other_devices(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.connection === 'live'")
    gateway.light_weights[1] = 0.0
    gateway.send(gateway.control_state())
    expect(opened.page.get_by_role("switch", name="Switch Window")).not_to_be_checked()
    assert opened.state()["weights"] == [1, 0]


def test_status_tells_what_ran_what_was_skipped_and_why(gateway, open_page) -> None:
    stage = {"wall_ms": 1.0, "cpu_ms": 2.0, "error_bound": 0.0}
    gateway.processes = {
        "illumination": {
            "stages": [
                {
                    **stage,
                    "name": "gather",
                    "ran": True,
                    "part": 0.12,
                    "reason": "new pictures",
                    "saved_ms": 30.0,
                },
                {**stage, "name": "probe", "ran": False, "part": 0.0, "reason": "unchanged", "saved_ms": 8.4},
            ],
            "skipping": {
                "age_s": 72.0,
                "saved_ms": 38.4,
                "saved_total_ms": 90_000.0,
                "spent_total_ms": 30_000.0,
                "error_bound": 0.02,
            },
        }
    }
    opened = open_page(gateway.url)
    opened.wait_for("s.connection === 'live' && s.sequence === 1")
    opened.page.wait_for_timeout(1500)
    assert gateway.status_requests == 0  # nobody looks
    opened.page.get_by_role("tab", name="Status").tap()
    panel = opened.page.get_by_role("tabpanel", name="Status")
    for text in (
        "38 ms",
        "1.5 min (75 %)",
        "at most 2.0 %",
        "Light from the cameras",
        "ran in part (12 %)",
        "new pictures, saved 30 ms",
        "What objects see",
        "unchanged, saved 8.4 ms",
        "1.2 min ago: 1 ran, 1 skipped",
    ):
        expect(panel.get_by_text(text, exact=True)).to_be_visible()
    expect(panel.get_by_text("Camera picture", exact=True)).to_be_visible()
    gateway.processes = {}
    expect(panel.get_by_text("at most 2.0 %", exact=True)).to_be_hidden()
    opened.page.get_by_role("tab", name="Lamps").tap()
    opened.page.wait_for_timeout(1500)
    asked = gateway.status_requests
    opened.page.wait_for_timeout(1500)
    assert gateway.status_requests == asked
    assert opened.complaints == []


def test_lost_connection_is_shown_and_recovers(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.connection === 'live'")
    gateway.accepting = False
    gateway.disconnect(1012, "the service restarts")
    expect(opened.page.get_by_text("The connection to the server is lost")).to_be_visible()
    assert opened.state()["connection"] != "live"
    gateway.accepting = True
    opened.wait_for("s.connection === 'live'")
    expect(opened.page.get_by_text("Connected again.")).to_be_visible()
    # Whatever the server did meanwhile: light arrives again.
    sequence = opened.state()["sequence"]
    gateway.send(gateway.light_packet(3.0))
    opened.wait_for(f"s.sequence > {sequence}")


def test_other_version_asks_for_a_reload(serve, scene, open_page) -> None:
    scene["protocol_version"] = 999
    opened = open_page(serve(scene).url, ready=False)
    expect(opened.page.get_by_role("heading", name="This page is out of date")).to_be_visible()
    expect(opened.page.get_by_role("button", name="Reload the page")).to_be_visible()


def test_refusal_by_the_server_is_explained(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.connection === 'live'")
    gateway.disconnect(4013, "as many clients as allowed are connected")
    expect(opened.page.get_by_role("heading", name="The server is full")).to_be_visible()


def test_light_of_another_room_asks_for_a_reload(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.sequence === 1")
    gateway.room_revision = 2
    gateway.send(gateway.light_packet(9.0))
    expect(opened.page.get_by_role("heading", name="The room has changed")).to_be_visible()
    assert opened.state()["sequence"] == 1


def test_failed_drawing_is_explained_once(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.sequence === 1")
    opened.page.evaluate(
        "() => { window.standIn.render = () => { throw new Error('out of texture memory') } }"
    )
    gateway.send(gateway.light_packet(9.0))
    expect(opened.page.get_by_role("heading", name="The picture cannot be drawn")).to_be_visible()
    expect(opened.page.get_by_text("out of texture memory")).to_be_visible()
    assert opened.complaints == []


def test_objects_are_dragged_turned_and_put_back(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.connection === 'live'")
    page = opened.page
    page.get_by_role("tab", name="Objects").tap()
    first = opened.state()["objectPoses"][0]
    x, y = _on_screen(page, first)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y - 10, steps=4)
    page.mouse.up()
    moved = opened.state()
    assert moved["selectedObject"] == 0
    assert moved["objectPoses"][0][3] > first[3] + 0.05
    assert moved["objectPoses"][0][7] == pytest.approx(0, abs=1e-6)
    expect(page.get_by_role("button", name="Bunny")).to_have_attribute("aria-pressed", "true")
    page.get_by_role("button", name="Turn left").tap()
    angle = np.deg2rad(15)
    turned = opened.state()["objectPoses"][0]
    assert turned[0] == pytest.approx(np.cos(angle))
    assert turned[2] == pytest.approx(np.sin(angle))
    page.get_by_role("button", name="Put back").tap()
    assert opened.state()["objectPoses"][0] == pytest.approx(first)
    _until(
        page, lambda: len(_poses(gateway)) > 0 and np.allclose(_poses(gateway)[-1].position, (1.5, 0, 1.5))
    )
    assert opened.complaints == []


def test_keys_move_the_selected_object(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.connection === 'live'")
    page = opened.page
    page.get_by_role("tab", name="Objects").tap()
    page.get_by_role("button", name="Dragon").tap()
    before = opened.state()["objectPoses"][1]
    page.locator("canvas").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowUp")
    after = opened.state()["objectPoses"][1]
    assert after[3] == pytest.approx(before[3] + 0.02)
    assert after[11] == pytest.approx(before[11] - 0.02)
    page.keyboard.press("Escape")
    assert opened.state()["selectedObject"] == -1
    page.keyboard.press("2")
    assert opened.state()["view"] == 1
    page.keyboard.press("0")
    assert opened.state()["view"] == "free"


def test_picture_rests_when_nothing_changes(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.sequence === 1")
    page = opened.page
    page.wait_for_timeout(600)
    frames = page.evaluate("window.standIn.calls.render")
    page.wait_for_timeout(600)
    assert page.evaluate("window.standIn.calls.render") == frames
    gateway.send(gateway.light_packet(4.0))
    opened.wait_for("s.sequence === 2")
    page.evaluate("window.nearfield.waitForLight(2)")
    assert page.evaluate("window.standIn.calls.render") > frames


def test_evaluation_mode_shows_the_exact_packet_only(gateway, open_page) -> None:
    opened = open_page(f"{gateway.url}?mode=evaluate")
    page = opened.page
    opened.wait_for("s.sequence === 1")
    expect(page.get_by_role("tab")).to_have_count(0)
    assert page.evaluate("window.standIn.calls.render ?? 0") == 0
    packet = base64.b64encode(gateway.light_packet(6.0)).decode()
    assert page.evaluate("packet => window.nearfield.applyLightPacket(packet)", packet)
    page.evaluate("window.nearfield.waitForLight(2)")
    result = page.evaluate("window.nearfield.renderViewComposite(1)")
    composite = np.frombuffer(base64.b64decode(result["data"]), "<f4").reshape(
        result["height"], result["width"], 4
    )
    assert composite.shape == (540, 960, 4)
    np.testing.assert_array_equal(composite, np.float32(6.5))
    assert page.evaluate("window.standIn.calls.render") == 1
    assert opened.complaints == []


def _weights(gateway: Any) -> list[tuple[int, float]]:
    return [(message.light_index, message.weight) for message in gateway.messages(SetLightWeight)]


def _poses(gateway: Any) -> list[Any]:
    return gateway.messages(SetObjectPose)


def _until(page: Page, condition: Callable[[], bool]) -> None:
    for _ in range(200):
        if condition():
            return
        page.wait_for_timeout(25)
    raise AssertionError("the expected state was not reached")


def _area(page: Page) -> float:
    box = page.locator("canvas").bounding_box()
    assert box is not None
    return box["width"] * box["height"]


def _on_screen(page: Page, pose: list[float]) -> tuple[float, float]:
    """Where an object's origin appears in view 1, CSS pixels."""
    x, y, z = pose[3] - 2, 0.8 - pose[7], 4 - pose[11]
    box = page.locator("canvas").bounding_box()
    assert box is not None
    pixel = 600 * x / z + 479.5, 600 * y / z + 269.5
    return box["x"] + (pixel[0] + 0.5) / 960 * box["width"], box["y"] + (pixel[1] + 0.5) / 540 * box["height"]


class Fingers:
    """Touches at these points (CSS pixels); one session, since touches belong to it."""

    def __init__(self, page: Page) -> None:
        self._session = page.context.new_cdp_session(page)

    def __call__(self, kind: str, *points: tuple[float, float]) -> None:
        touches = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        self._session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})


def test_two_fingers_turn_the_object_that_the_first_one_holds(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.connection === 'live'")
    page = opened.page
    x, y = _on_screen(page, opened.state()["objectPoses"][0])
    touch = Fingers(page)
    touch("touchStart", (x, y))
    touch("touchStart", (x, y), (x + 80, y))
    for degrees in (10, 20, 30):
        angle = np.deg2rad(degrees)
        touch("touchMove", (x, y), (x + 80 * np.cos(angle), y + 80 * np.sin(angle)))
    touch("touchEnd")
    pose = opened.state()["objectPoses"][0]
    # Clockwise on the screen is clockwise seen from above: a negative turn about +y.
    assert np.rad2deg(np.arctan2(pose[2], pose[0])) == pytest.approx(-30, abs=1.0)
    assert pose[3] == pytest.approx(1.5)
    assert opened.complaints == []


def test_free_camera_orbits_by_finger_and_stays_in_the_room(gateway, open_page) -> None:
    opened = open_page(gateway.url)
    opened.wait_for("s.connection === 'live'")
    page = opened.page
    page.keyboard.press("Tab")
    page.get_by_role("radio", name="Free orbit").check(force=True)
    before = opened.state()["worldFromCamera"]
    touch = Fingers(page)
    touch("touchStart", (200, 300))
    for step in range(1, 6):
        touch("touchMove", (200 + 60 * step, 300))
    touch("touchEnd")
    page.wait_for_timeout(300)
    after = opened.state()["worldFromCamera"]
    assert np.linalg.norm(np.subtract(after, before)) > 0.2
    eye = np.array(after)[[3, 7, 11]]
    assert (eye > 0).all()
    assert (eye < (4, 2.5, 4)).all()
    # A finger on the room moves no object.
    assert opened.state()["objectPoses"][0][3] == 1.5

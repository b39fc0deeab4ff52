"""The whole chain, as users have it: the service, a real browser, a lamp that is switched, and path-traced truth."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.service.harness import TINY_ROOM, Service

from nearfield_protocol.codec import LightPacket
from nearfield_server.evaluation.browser import decode_picture, find_browser
from nearfield_server.evaluation.view_truth import bundle_exposure, emitter_faces, judge_view, load_view_truth
from nearfield_server.radiometry.image_metrics import average_2x2
from nearfield_server.scene.bundle import load_bundle
from nearfield_server.scene.room_model import load_room_mesh

playwright = pytest.importorskip("playwright.sync_api")

pytestmark = [pytest.mark.service, pytest.mark.browser, pytest.mark.timeout(600)]

PATIENCE_MS = 240_000
ARGUMENTS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=gl-egl",
    "--ignore-gpu-blocklist",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    running = Service(tmp_path_factory.mktemp("service") / "service.log")
    try:
        running.running()
        yield running
    finally:
        assert running.close() == 0


@pytest.fixture(scope="module")
def page(service: Service) -> Iterator[Any]:
    address = re.search(r"http://127\.0\.0\.1:\d+/", service.log_text())
    assert address is not None, "the service did not print its address"
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=find_browser(), args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1024, "height": 768})
        page.set_default_timeout(PATIENCE_MS)
        problems: list[str] = []
        page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(address.group())
        page.wait_for_function("() => window.nearfield !== undefined")
        page.evaluate("() => window.nearfield.ready")
        page.wait_for_function("() => window.nearfield.state().sequence !== null")
        yield page
        browser.close()
    assert problems == []


def composite(page: Any) -> NDArray[np.float64]:
    """What the page shows in tablet view 0 with the light it has now, linear, averaged 2x2."""
    sequence = page.evaluate("() => window.nearfield.state().sequence")
    page.evaluate("(sequence) => window.nearfield.waitForLight(sequence)", sequence)
    picture = decode_picture(page.evaluate("() => window.nearfield.renderViewComposite(0)"))
    return average_2x2(picture[..., :3].astype(np.float64))


def errors(picture: NDArray[np.float64], weights: list[float]) -> dict[str, Any]:
    bundle = load_bundle(TINY_ROOM)
    mesh = load_room_mesh(bundle.model_path, 1024)
    truth = load_view_truth(bundle, bundle.views[0], np.array(weights), mesh, emitter_faces(bundle, mesh))
    return judge_view(truth, picture, bundle_exposure(bundle))


def switch(page: Any, service: Service, lamp: int, weight: float) -> None:
    """Use the lamp's switch in the page and wait until the light of the room has followed."""
    before = service.picture_times()
    page.evaluate("([lamp, weight]) => window.nearfield.setLightWeight(lamp, weight)", [lamp, weight])
    page.wait_for_function(
        "([lamp, weight]) => window.nearfield.state().weights[lamp] === weight", arg=[lamp, weight]
    )
    # Cameras deliver the change one after the other.
    show(page, service.settle(before))


def show(page: Any, light: LightPacket) -> None:
    """Wait until the page has this light or a newer one."""
    page.wait_for_function(
        "(sequence) => window.nearfield.state().sequence >= sequence", arg=int(light.sequence)
    )


def test_the_picture_follows_the_lamp_and_agrees_with_truth(page: Any, service: Service) -> None:
    both_on, one_on = [1.0, 1.0], [0.0, 1.0]
    show(page, service.settle())
    first = composite(page)
    switch(page, service, 0, 0.0)
    second = composite(page)
    switch(page, service, 0, 1.0)
    third = composite(page)

    for picture, lit, other in ((first, both_on, one_on), (second, one_on, both_on)):
        right, wrong = errors(picture, lit), errors(picture, other)
        assert right["object_rel_rmse"] < 0.20
        assert right["shadow_rel_rmse"] < 0.45
        assert right["object_rel_rmse"] < 0.5 * wrong["object_rel_rmse"]
        assert right["flip_mean"] < 0.5 * wrong["flip_mean"]
    # The way back leads to the same picture: nothing is left of the other light.
    assert np.abs(third - first).mean() < 0.01 * first.mean()


def test_the_page_shows_what_arrives(page: Any) -> None:
    state = page.evaluate("() => window.nearfield.state()")
    assert state["connection"] == "live"
    assert state["numVals"] == 16
    # Half of the 32 bytes per VAL and 108 per object of Rohmer et al. 2014, behind a header of 80 and one pose revision.
    assert 0 < state["packetBytes"] <= 80 + (16 * 32 + 108) // 2 + 8
    playwright.expect(page.get_by_text(re.compile("^Live")).first).to_be_visible()


def test_nothing_is_drawn_when_nothing_changes(page: Any) -> None:
    page.wait_for_timeout(5000)
    before = page.evaluate("() => window.nearfield.state().lastFrame")
    page.wait_for_timeout(3000)
    # The time of the last frame would differ if another one had been drawn meanwhile.
    assert page.evaluate("() => window.nearfield.state().lastFrame") == before


def test_the_status_page_shows_every_camera_with_its_picture_and_its_last_minutes(
    page: Any, service: Service
) -> None:
    room = load_bundle(TINY_ROOM)
    status = page.context.browser.new_page()
    problems: list[str] = []
    status.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    status.on("pageerror", lambda error: problems.append(str(error)))
    status.goto(page.url.split("#")[0].rstrip("/") + "/status")
    cards = status.locator(".camera")
    cards.nth(len(room.cameras) - 1).wait_for()
    assert cards.locator("h3").all_inner_texts() == [camera.model.camera_id for camera in room.cameras]
    cards.nth(0).get_by_text("live", exact=True).wait_for()
    # A picture that is all there, of a room that is lit.
    status.wait_for_function(
        "() => { const image = document.querySelector('.preview img'); return !image.hidden && image.naturalWidth > 0 }"
    )
    brightest = status.evaluate(
        """() => {
            const image = document.querySelector('.preview img')
            const canvas = new OffscreenCanvas(image.naturalWidth, image.naturalHeight)
            const context = canvas.getContext('2d')
            context.drawImage(image, 0, 0)
            return Math.max(...context.getImageData(0, 0, canvas.width, canvas.height).data.filter((_, i) => i % 4 !== 3))
        }"""
    )
    assert brightest > 128
    status.wait_for_function("() => document.querySelector('.camera .chart path').getAttribute('d') !== ''")
    names = status.locator(".work-name").all_inner_texts()
    assert {"illumination", "gateway", "cam0"} <= set(names)
    status.close()
    assert problems == []

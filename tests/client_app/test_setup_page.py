"""The set-up page in headless Chromium, with cameras that are made up and a room file that is not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.server.onboarding.conftest import Lab

from nearfield_server.gateway.pages import BUILT_CLIENT
from nearfield_server.gateway.server import serve_in_thread
from nearfield_server.gateway.setup_app import create_setup_app
from nearfield_server.scene.room_config import load_room

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not (BUILT_CLIENT / "setup.html").is_file(), reason="the pages are not built"),
]


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    made = Lab(tmp_path)
    yield made
    made.session.close()


def test_from_pictures_to_the_room_file(browser: Any, lab: Lab) -> None:
    faults: list[str] = []
    with serve_in_thread(create_setup_app(lab.session)) as url:
        page = browser.new_page(viewport={"width": 820, "height": 1180})
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
        page.goto(url)
        cards = page.locator(".card.camera")
        cards.first.locator(".preview img:not([hidden])").wait_for()
        assert cards.count() == 4
        assert cards.nth(2).locator(".state").inner_text() == "in use"
        assert cards.nth(2).locator("img").count() == 0
        first = cards.first
        assert first.locator(".circle circle").count() == 1
        # The slider counts stops: 2^-7 s.
        first.locator("input[type=range]").first.fill("-7")
        first.locator("output", has_text="1/128 s").wait_for()
        first.get_by_role("button", name="Find the exposure").click()
        first.locator("output", has_text="1/50 s").wait_for()
        first.get_by_label("Name", exact=True).fill("front door")
        page.get_by_role("button", name="Write the room file").click()
        page.locator(".outcome[data-tone=bad]").wait_for()
        assert not (lab.folder / "room.toml").exists()
        first.get_by_label("Name", exact=True).fill("door")
        page.get_by_label("Name of the room").fill("lab")
        page.get_by_role("button", name="Write the room file").click()
        page.locator(".outcome[data-tone=good]").wait_for()
        page.get_by_role("button", name="Add to the room file").wait_for()
        page.close()
    room = load_room(lab.folder)
    assert room.name == "lab"
    assert [camera.camera_id for camera in room.cameras] == ["door", "cam1"]
    assert room.sources[0].exposure_s == pytest.approx(0.02, rel=0.02)  # type: ignore[union-attr]
    assert faults == []

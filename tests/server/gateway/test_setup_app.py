"""The set-up page's requests over real HTTP, with cameras that are made up."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from tests.server.onboarding.conftest import Lab

from nearfield_server.gateway.server import serve_in_thread
from nearfield_server.gateway.setup_app import create_setup_app
from nearfield_server.scene.room_config import load_room


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    made = Lab(tmp_path)
    yield made
    made.session.close()


@pytest.fixture
def client(lab: Lab, tmp_path: Path) -> Iterator[httpx.Client]:
    static = tmp_path / "static"
    static.mkdir()
    (static / "setup.html").write_text("<p>set-up</p>")
    with (
        serve_in_thread(create_setup_app(lab.session, static)) as url,
        httpx.Client(base_url=url, timeout=60) as client,
    ):
        yield client


def test_from_the_list_to_the_room(client: httpx.Client, lab: Lab) -> None:
    state = client.get("api/setup").json()
    assert [camera["state"] for camera in state["cameras"]] == ["free", "free", "in use", "free"]
    assert [camera["pixel_format"] for camera in state["cameras"]] == ["BayerRG12p", "Mono8", None, None]
    assert state["models"] == ["room.glb"]
    assert state["room"]["exists"] is False
    look = client.get("api/setup/cameras/0/look", params={"exposure_s": 0.03}).json()
    head, _, data = look["picture"].partition(",")
    assert head == "data:image/jpeg;base64"
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (look["height"], look["width"], 3)
    assert look["exposure_s"] == 0.03
    assert look["circle"] == pytest.approx({"x": 60, "y": 50, "radius": 40}, abs=1)
    camera = {"index": 0, "id": "door", "exposure_s": look["exposure_s"], "field_degrees": 185}
    answer = client.post("api/setup/room", json={"cameras": [camera], "name": "lab", "model": "room.glb"})
    assert answer.status_code == 200
    assert answer.json()["cameras"] == ["door"]
    assert load_room(lab.folder).cameras[0].camera_id == "door"
    state = client.get("api/setup").json()
    assert state["room"]["camera_ids"] == ["door"]
    assert [camera["is_in_room"] for camera in state["cameras"]] == [True, False, False, False]


def test_saturated_pixels_are_counted_and_marked_red(client: httpx.Client) -> None:
    look = client.get("api/setup/cameras/0/look", params={"exposure_s": 0.1}).json()
    assert look["saturated_share"] == pytest.approx(np.pi * 40**2 / (120 * 100), rel=0.02)
    data = base64.b64decode(look["picture"].partition(",")[2])
    blue, green, red = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[50, 60].astype(int)
    assert red > 200
    assert max(blue, green) < 100


def test_an_exposure_that_suits_is_found(client: httpx.Client) -> None:
    look = client.post("api/setup/cameras/0/expose", params={"pixel_format": "Mono8"}).json()
    assert (look["pixel_format"], look["exposure_s"]) == ("Mono8", pytest.approx(0.02, rel=0.1))
    assert client.post("api/setup/cameras/2/expose").status_code == 503


def test_searching_again(client: httpx.Client, lab: Lab) -> None:
    assert client.post("api/setup/search").json()["notes"] == ["a note"]
    assert lab.searches == 2


@pytest.mark.parametrize(
    ("method", "path", "body", "status", "words"),
    [
        ("GET", "api/setup/cameras/2/look", None, 503, "in use"),
        ("GET", "api/setup/cameras/7/look", None, 409, "search again"),
        ("GET", "api/setup/cameras/0/look?exposure_s=nan", None, 422, ""),
        ("GET", "api/setup/cameras/0/look?pixel_format=RGB8", None, 409, "pixel formats"),
        ("POST", "api/setup/room", {"cameras": []}, 422, ""),
        ("POST", "api/setup/room", {"cameras": [{"index": 0, "id": "a b"}]}, 422, ""),
        ("POST", "api/setup/room", {"cameras": [{"index": 0, "id": "a"}], "path": "/etc/passwd"}, 422, ""),
        ("POST", "api/setup/room", {"cameras": [{"index": 0, "id": "a"}]}, 409, "no model"),
        (
            "POST",
            "api/setup/room",
            {"cameras": [{"index": 0, "id": "a"}], "model": "gone.glb"},
            409,
            "gone.glb",
        ),
    ],
)
def test_refusals(
    client: httpx.Client, lab: Lab, method: str, path: str, body: object, status: int, words: str
) -> None:
    answer = client.request(method, path, json=body)
    assert answer.status_code == status
    assert words in answer.text
    assert not (lab.folder / "room.toml").exists()


def test_only_its_own_page_may_use_it(client: httpx.Client, lab: Lab) -> None:
    body = {"cameras": [{"index": 0, "id": "a"}], "model": "room.glb"}
    for headers in ({"Origin": "http://elsewhere.example"}, {"Host": "rebound.example"}):
        assert client.post("api/setup/room", json=body, headers=headers).status_code == 403
    assert client.post("api/setup/room", content="cameras=1").status_code == 422
    assert not (lab.folder / "room.toml").exists()
    page = client.get("/")
    assert page.text == "<p>set-up</p>"
    assert "default-src 'self'" in page.headers["content-security-policy"]


def test_a_page_that_is_not_built(lab: Lab, tmp_path: Path) -> None:
    with serve_in_thread(create_setup_app(lab.session, tmp_path / "nothing")) as url:
        answer = httpx.get(url)
    assert answer.status_code == 503
    assert "npm run build" in answer.text

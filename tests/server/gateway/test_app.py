"""Page, REST, assets and metrics over real HTTP."""

from __future__ import annotations

import math
import time
from pathlib import Path

import httpx
import pytest

from nearfield_server.errors import ServiceError
from nearfield_server.gateway.hub import LightHealth
from nearfield_server.gateway.listener import open_listener

from .conftest import StartGateway, light_bytes, scene_json


def test_scene(start_gateway: StartGateway) -> None:
    answer = httpx.get(start_gateway().url + "api/scene")
    assert answer.headers["content-type"] == "application/json"
    found = answer.json()
    assert found["room"]["atlas"]["stream_width"] == 256
    assert found["settings"]["exposure"] is None
    for key, value in scene_json()["room"].items():
        if key not in ("atlas", "bounds"):
            assert found["room"][key] == value


def test_page_that_is_not_built_says_what_to_do(start_gateway: StartGateway) -> None:
    answer = httpx.get(start_gateway().url)
    assert answer.status_code == 503
    assert "npm run build" in answer.text


def test_built_page_and_its_scripts(start_gateway: StartGateway, tmp_path: Path) -> None:
    static = tmp_path / "static"
    (static / "assets").mkdir(parents=True)
    (static / "index.html").write_text("<p>page</p>")
    (static / "assets" / "index-abc.js").write_text("let x")
    url = start_gateway(static_dir=static).url
    page = httpx.get(url)
    assert (page.text, page.headers["cache-control"]) == ("<p>page</p>", "no-cache")
    script = httpx.get(url + "assets/index-abc.js")
    assert script.text == "let x"
    assert script.headers["content-type"].startswith("text/javascript")


def test_assets_by_whitelist(start_gateway: StartGateway, tmp_path: Path) -> None:
    model = tmp_path / "some model.glb"
    model.write_bytes(bytes(range(256)))
    url = start_gateway(assets={"assets/objects/bunny.glb": model}).url
    answer = httpx.get(url + "assets/objects/bunny.glb")
    assert answer.content == model.read_bytes()
    assert answer.headers["content-type"] == "model/gltf-binary"
    assert int(httpx.head(url + "assets/objects/bunny.glb").headers["content-length"]) == 256
    again = httpx.get(url + "assets/objects/bunny.glb", headers={"If-None-Match": answer.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert httpx.get(url + "assets/objects/other.glb").status_code == 404
    assert httpx.post(url + "assets/objects/bunny.glb").status_code in (404, 405)


def test_status_and_metrics(start_gateway: StartGateway) -> None:
    gateway = start_gateway(status=lambda: {"processes": {"cam0": {"pid": 1}}})
    before = httpx.get(gateway.url + "api/status").json()
    assert before["light"] == {
        "sequence": None,
        "num_bytes": None,
        "age_s": None,
        "camera_ages_s": [],
        "is_stale": True,
    }
    gateway.tablet().read()
    gateway.hub.publish_light(light_bytes(4))
    ages = (0.01, math.inf)
    gateway.hub.publish_health(LightHealth(light_age=0.02, camera_ages=ages, reported=time.monotonic()))
    time.sleep(0.1)
    after = httpx.get(gateway.url + "api/status").json()
    assert after["clients"] == 1
    assert after["processes"]["cam0"]["pid"] == 1
    assert after["light"]["sequence"] == 4
    assert after["light"]["camera_ages_s"][1] is None
    assert not after["light"]["is_stale"]
    metrics = httpx.get(gateway.url + "metrics").text
    assert "nearfield_clients 1.0" in metrics
    assert "nearfield_light_packets_total 1.0" in metrics
    assert "process_resident_memory_bytes" in metrics


def test_silent_illumination_makes_the_light_stale(start_gateway: StartGateway) -> None:
    gateway = start_gateway()
    health = LightHealth(light_age=0.02, camera_ages=(0.02,), reported=time.monotonic() - 2.5)
    gateway.hub.publish_health(health)
    time.sleep(0.1)
    light = httpx.get(gateway.url + "api/status").json()["light"]
    assert light["is_stale"]
    assert light["age_s"] >= 2.5


@pytest.mark.parametrize("path", ["docs", "openapi.json", "redoc"])
def test_no_developer_pages(start_gateway: StartGateway, path: str) -> None:
    assert httpx.get(start_gateway().url + path).status_code == 404


def test_port_in_use_says_what_to_do() -> None:
    with open_listener("127.0.0.1", 0) as first:
        port = first.getsockname()[1]
        with pytest.raises(
            ServiceError, match=rf"127\.0\.0\.1 port {port}: .*choose another port with --port"
        ):
            open_listener("127.0.0.1", port)

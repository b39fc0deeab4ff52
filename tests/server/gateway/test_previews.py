"""Previews over HTTP, with capture processes that are a function."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import httpx

from nearfield_server.bus.messages import PreviewRequest
from nearfield_server.errors import BusError
from nearfield_server.gateway.previews import CameraPreviews

from .conftest import StartGateway


class Cameras:
    """Answers like two capture processes; the second has no picture yet."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, PreviewRequest]] = []
        self.is_asked = threading.Event()
        self.answering = threading.Event()
        self.answering.set()

    def ask(self, key: str, timeout_s: float = 1.0, question: bytes = b"") -> bytes | None:
        self.asked.append((key, PreviewRequest.from_json(question)))
        self.is_asked.set()
        self.answering.wait(60)
        return b"jpeg of cam0" if key == "preview/cam0" else b""


class ClosedBus:
    def ask(self, key: str, timeout_s: float = 1.0, question: bytes = b"") -> bytes | None:
        raise BusError("closed")


def test_a_camera_is_asked_by_its_place_in_the_room(start_gateway: StartGateway) -> None:
    cameras = Cameras()
    url = start_gateway(previews=CameraPreviews(cameras, ("door", "window"))).url + "api/cameras"
    answer = httpx.get(f"{url}/door/preview.jpg", params={"size": 256, "stops": -1, "marks": 0})
    assert (answer.status_code, answer.content) == (200, b"jpeg of cam0")
    assert answer.headers["content-type"] == "image/jpeg"
    assert answer.headers["cache-control"] == "no-store"
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    assert cameras.asked == [("preview/cam0", PreviewRequest(max_side=256, stops=-1.0, marks=False))]
    waiting = httpx.get(f"{url}/window/preview.jpg")
    assert waiting.status_code == 503
    assert "'window' has no picture" in waiting.text


def test_impossible_questions(start_gateway: StartGateway) -> None:
    cameras = Cameras()
    url = start_gateway(previews=CameraPreviews(cameras, ("door",))).url + "api/cameras"
    unknown = httpx.get(f"{url}/cellar/preview.jpg")
    assert unknown.status_code == 404
    assert "door" in unknown.text
    for parameters in ("size=5000", "size=1", "stops=nan", "stops=1e9"):
        assert httpx.get(f"{url}/door/preview.jpg?{parameters}").status_code == 422
    assert cameras.asked == []


def test_many_viewers_of_one_camera_ask_it_once(start_gateway: StartGateway) -> None:
    cameras = Cameras()
    cameras.answering.clear()
    url = start_gateway(previews=CameraPreviews(cameras, ("door",))).url + "api/cameras/door/preview.jpg"
    with ThreadPoolExecutor(6) as pool:
        answers = [pool.submit(httpx.get, url, timeout=30) for _ in range(6)]
        assert cameras.is_asked.wait(60)
        cameras.answering.set()
        assert {answer.result().content for answer in answers} == {b"jpeg of cam0"}
    assert len(cameras.asked) < 6


def test_a_lost_bus_is_a_missing_picture(start_gateway: StartGateway) -> None:
    url = start_gateway(previews=CameraPreviews(ClosedBus(), ("door",))).url
    assert httpx.get(url + "api/cameras/door/preview.jpg").status_code == 503

from __future__ import annotations

from pathlib import Path

import pytest

from nearfield_server.virtual_lab.backend import Backend, load_backend
from nearfield_server.virtual_lab.model import Scene
from nearfield_server.virtual_lab.tiny_room import build_tiny_room

REPOSITORY = Path(__file__).parents[3]
BUNDLES = {
    "tiny": REPOSITORY / "tests" / "data" / "tiny_room",
    "lab": REPOSITORY / "server" / "nearfield_server" / "rooms" / "lab",
}


@pytest.fixture(scope="session")
def backend() -> Backend:
    pytest.importorskip("mitsuba", reason="the optional extra `lab` (Mitsuba) is not installed")
    return load_backend()


@pytest.fixture(scope="session")
def tiny_scene() -> Scene:
    return build_tiny_room()


@pytest.fixture(params=sorted(BUNDLES))
def bundle(request: pytest.FixtureRequest) -> Path:
    return BUNDLES[request.param]

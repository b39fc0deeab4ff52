"""Latency of the real service and the real page; how long it takes is not judged here."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from nearfield_server.benchmark import latency
from nearfield_server.benchmark.running_service import running_service
from nearfield_server.errors import ServiceError
from nearfield_server.gateway.pages import BUILT_CLIENT

TINY_ROOM = Path(__file__).parents[2] / "data" / "tiny_room"


def test_percentiles_of_known_numbers() -> None:
    found = latency.summarise(np.arange(101.0).tolist())
    assert found == {"p50": 50.0, "p99": 99.0, "count": 101}


def test_the_liveliest_sequence_changes_most_often(monkeypatch: pytest.MonkeyPatch) -> None:
    still, lively = np.ones((8, 2)), np.linspace(0.0, 1.0, 16).reshape(8, 2)
    sequences = [
        SimpleNamespace(name=name, weights=weights)
        for name, weights in (("still", still), ("lively", lively))
    ]
    monkeypatch.setattr(latency, "load_bundle", lambda folder: SimpleNamespace(sequences=sequences))
    assert latency.liveliest_sequence(TINY_ROOM) == "lively"
    sequences.clear()
    with pytest.raises(ServiceError, match="lighting sequence"):
        latency.liveliest_sequence(TINY_ROOM)


@pytest.mark.service
@pytest.mark.timeout(600)
def test_packets_are_younger_than_their_journey_through_the_service() -> None:
    sequence = latency.liveliest_sequence(TINY_ROOM)
    with running_service(TINY_ROOM, "--rate", "10", "--sequence", sequence) as url:
        found = latency.packet_latencies(url, 5)
    assert len(found) == 5
    assert all(0.0 < value < 1e3 * latency.PATIENCE_S for value in found)


@pytest.mark.service
@pytest.mark.browser
@pytest.mark.timeout(600)
@pytest.mark.skipif(not (BUILT_CLIENT / "index.html").is_file(), reason="the page is not built")
def test_the_page_shows_the_light_of_a_switched_lamp() -> None:
    pytest.importorskip("playwright.sync_api")
    with running_service(TINY_ROOM) as url:
        found = latency.switch_latencies(url, 2)
    assert len(found) == 2
    assert all(0.0 < value < 1e3 * latency.PATIENCE_S for value in found)

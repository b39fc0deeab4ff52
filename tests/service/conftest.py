"""One service for the tests that leave it as they found it, and fresh ones for those that end it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.service.harness import Service


@pytest.fixture
def start_service(tmp_path: Path) -> Iterator[Callable[..., Service]]:
    """Start services that are ended after the test."""
    services: list[Service] = []

    def start(*arguments: str, **environment: str) -> Service:
        services.append(Service(tmp_path / f"service{len(services)}.log", *arguments, **environment))
        return services[-1]

    yield start
    for service in services:
        service.close()


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service shared by the tests of a module."""
    running = Service(tmp_path_factory.mktemp("service") / "service.log")
    try:
        running.running()
        yield running
    finally:
        assert running.close() == 0

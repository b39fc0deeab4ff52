"""A service for measurements: failures are told in words, and nothing is left behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from nearfield_server.benchmark.running_service import running_service
from nearfield_server.errors import ServiceError


@pytest.mark.timeout(300)
def test_a_service_that_ends_says_why(tmp_path: Path) -> None:
    with (
        pytest.raises(ServiceError, match=r"ended with code 2; it said: .*no such room"),
        running_service(tmp_path / "nowhere"),
    ):
        pass

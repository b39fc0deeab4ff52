"""The shipped tiny bundle."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def tiny_room() -> Path:
    return Path(__file__).parents[2] / "data" / "tiny_room"

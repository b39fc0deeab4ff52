"""Laws of light over time, measured on the box room and on the tiny room that comes with the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nearfield_server.benchmark.scenario import Scenario, box_scenario, bundle_scenario
from nearfield_server.benchmark.temporal import measure_temporal

TINY_ROOM = Path(__file__).parents[2] / "data" / "tiny_room"


@pytest.fixture(scope="module", params=["box", "tiny"])
def measured(request: pytest.FixtureRequest) -> tuple[Scenario, dict[str, Any]]:
    scenario = box_scenario(192) if request.param == "box" else bundle_scenario(TINY_ROOM)
    return scenario, measure_temporal(scenario, quick=True)


def test_noise_moves_no_light_and_renews_no_slot(measured: tuple[Scenario, dict[str, Any]]) -> None:
    _, report = measured
    assert report["val_movement_mm"] < 5.0
    assert report["generation_changes"] == 0
    assert report["noise"]["vals_that_come_and_go"] == 0
    # A lamp that a few pixels show trembles by as much as these do: 1 % each, both ways, the largest of 30 updates.
    assert report["irradiance_flicker"] < 0.05


def test_light_is_right_within_two_updates_of_a_switch(measured: tuple[Scenario, dict[str, Any]]) -> None:
    scenario, report = measured
    assert len(report["lamps"]) == scenario.num_lamps == 2
    assert report["updates_to_right_light"] <= 2


def test_dimming_hands_light_over_without_a_jump(measured: tuple[Scenario, dict[str, Any]]) -> None:
    """Between direct and indirect light, and between VALs that come and go: 3 % of the full light at most."""
    _, report = measured
    assert report["irradiance_step"] < 0.03
    assert np.isfinite(report["lamps"][0]["even_step"])

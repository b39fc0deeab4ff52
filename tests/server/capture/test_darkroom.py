"""Brackets that follow the scene, from codes: nothing stays saturated, the dark is lifted, and then the plan rests."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from nearfield_server.capture.darkroom import Darkroom
from nearfield_server.capture.device import DeviceCapabilities, Exposure, SensorFrame
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import AravisSourceTable, BracketTable

HEIGHT, WIDTH = 32, 48
CAPABILITIES = DeviceCapabilities(exposure_range_s=(1e-5, 1.0))


def _table(**hdr: object) -> AravisSourceTable:
    return AravisSourceTable.model_validate(
        {
            "kind": "aravis",
            "address": "127.0.0.2",
            "pixel_format": "Mono12",
            "hdr": {"mode": "bracket", **hdr},
        }
    )


def _frame(radiance: NDArray[np.float64], exposure: Exposure, number: int) -> SensorFrame:
    """A 12 bit sensor without noise that is full at a radiance of 1 after one second."""
    codes = np.minimum(np.rint(4095.0 * radiance * exposure.amount), 4095).astype("<u2")
    return SensorFrame(
        data=codes.view(np.uint8).reshape(-1),
        pixel_format="Mono12",
        width=WIDTH,
        height=HEIGHT,
        frame_id=number,
        device_ns=None,
        arrival_ns=number,
        exposure=exposure,
    )


def _first(darkroom: Darkroom, table: AravisSourceTable, gain: float = 1.0) -> tuple[Exposure, ...]:
    assert isinstance(table.hdr, BracketTable)
    return darkroom.first_plan(table.hdr, CAPABILITIES, gain)


def _merged(
    darkroom: Darkroom, radiance: NDArray[np.float64], plan: tuple[Exposure, ...]
) -> tuple[NDArray[np.float16], int]:
    for index, exposure in enumerate(plan):
        darkroom.store(index, _frame(radiance, exposure, index))
    out = np.zeros((HEIGHT, WIDTH, 4), np.float16)
    return out, darkroom.merge(plan, out)


@pytest.mark.parametrize("gain", [1.0, 4.0])
@pytest.mark.parametrize("brightest", [30.0, 3000.0])
def test_an_automatic_bracket_comes_to_hold_the_scene_and_rests(brightest: float, gain: float) -> None:
    radiance = np.geomspace(brightest / 1e5, brightest, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
    table = _table(num_exposures=4, longest_s=0.5, shortest_s=2e-5)
    darkroom = Darkroom("cam0", table, WIDTH, HEIGHT)
    plan = _first(darkroom, table, gain)
    changes = 0
    for _ in range(30):
        _merged(darkroom, radiance, plan)
        better = darkroom.next_plan(plan)
        changes += better is not None
        plan = better or plan
    assert changes <= 6
    assert all(darkroom.next_plan(plan) is None for _ in range(4))
    out, num_bounds = _merged(darkroom, radiance, plan)
    assert num_bounds == 0
    assert {exposure.gain for exposure in plan} == {gain}
    # Each exposure is rounded by up to half a code, and the sum of the codes belongs to the sum of the exposures.
    smallest = 0.5 * len(plan) / 4095.0 / sum(exposure.amount for exposure in plan)
    np.testing.assert_allclose(out[..., 0].astype(np.float64), radiance, rtol=0.01, atol=1.01 * smallest)


def test_what_lies_outside_of_the_lens_asks_for_no_exposure() -> None:
    radiance = np.full((HEIGHT, WIDTH), 50.0)
    radiance[:, : WIDTH // 2] = 0.0
    circle = np.zeros((HEIGHT, WIDTH), np.bool_)
    circle[:, WIDTH // 2 :] = True
    table = _table(num_exposures=2, longest_s=0.5, shortest_s=2e-5)
    longest = {}
    for name, mask in (("circle", circle), ("everywhere", None)):
        darkroom = Darkroom("cam0", table, WIDTH, HEIGHT, mask)
        plan = _first(darkroom, table)
        for _ in range(30):
            _merged(darkroom, radiance, plan)
            plan = darkroom.next_plan(plan) or plan
        longest[name] = max(exposure.time_s for exposure in plan)
    assert longest["everywhere"] == pytest.approx(0.5)
    assert longest["circle"] < 0.05


def test_exposures_that_are_given_stay() -> None:
    table = _table(exposures_s=[0.01, 0.0001])
    darkroom = Darkroom("cam0", table, WIDTH, HEIGHT)
    plan = _first(darkroom, table)
    assert [exposure.time_s for exposure in plan] == [0.01, 0.0001]
    for _ in range(5):
        assert _merged(darkroom, np.full((HEIGHT, WIDTH), 1e6), plan)[1] == HEIGHT * WIDTH
        assert darkroom.next_plan(plan) is None


def test_a_device_without_a_range_of_exposures_is_told_in_words() -> None:
    table = _table(num_exposures=3)
    fixed = DeviceCapabilities(exposure_range_s=(0.02, 0.02))
    assert isinstance(table.hdr, BracketTable)
    with pytest.raises(CaptureError, match=r"from 0\.02 s to 0\.02 s.*hdr\.shortest_s"):
        Darkroom("cam0", table, WIDTH, HEIGHT).first_plan(table.hdr, fixed, 1.0)

"""Laws of the merge: exact without noise, unbiased with it, never black where every exposure is full."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.errors import CaptureError
from nearfield_server.imaging.hdr_merge import merge
from nearfield_server.imaging.pixel_formats import FORMATS
from nearfield_server.imaging.response import Response, make_response
from nearfield_server.reference.imaging import merged_samples
from nearfield_server.scene.device_schema import SensorTable


def _response(**keys: object) -> Response:
    return make_response(SensorTable.model_validate(keys), FORMATS["Mono12"])


@given(
    st.lists(st.floats(1e-5, 10.0), min_size=1, max_size=6),
    st.integers(0, 2**32),
    st.sampled_from([0.0, 60.5]),
)
def test_the_kernel_is_the_definition(amounts: list[float], seed: int, black_level: float) -> None:
    response = _response(black_level=black_level)
    codes = np.random.default_rng(seed).integers(0, 4096, (len(amounts), 3, 17), np.uint16)
    codes[:, 0] |= 0xFF0
    radiance, is_bound = merge(codes, response.lookup, response.saturated_from, amounts)
    signals = [((code - black_level) / (4095 - black_level)) for code in codes.astype(float)]
    expected, bound = merged_samples(signals, [c >= response.saturated_from for c in codes], amounts)
    np.testing.assert_array_equal(is_bound, bound)
    np.testing.assert_allclose(radiance, expected, rtol=3e-6, atol=1e-6 / max(amounts))


@given(st.permutations(range(4)))
def test_the_order_of_exposures_does_not_matter(order: list[int]) -> None:
    response, amounts = _response(black_level=50), np.array([1, 0.1, 0.01, 0.001])
    codes = np.random.default_rng(5).integers(0, 4096, (4, 20, 30), np.uint16)
    first, bound = merge(codes, response.lookup, response.saturated_from, amounts)
    second, bound_too = merge(codes[order], response.lookup, response.saturated_from, amounts[order])
    np.testing.assert_allclose(first, second, rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(bound, bound_too)


def test_what_fills_every_exposure_keeps_the_bound_of_the_shortest_one() -> None:
    response, amounts = _response(), [1.0, 1 / 16, 1 / 256]
    codes = np.full((3, 2, 2), 4095, np.uint16)
    codes[2, 0, 0] = 3000
    codes[2, 0, 1] = 4020  # above the threshold, but not full
    radiance, is_bound = merge(codes, response.lookup, response.saturated_from, amounts)
    np.testing.assert_array_equal(is_bound, [[False, True], [True, True]])
    np.testing.assert_allclose(radiance, 256 / 4095 * np.array([[3000, 4020], [4095, 4095]]), rtol=1e-6)


def test_no_exposures_are_refused() -> None:
    response = _response()
    for amounts in ([], [0.0], [1.0, np.nan], [-1.0]):
        with pytest.raises(CaptureError, match="seconds times gain above 0"):
            merge(np.zeros((len(amounts), 2, 2), np.uint16), response.lookup, 4000, amounts)
    with pytest.raises(CaptureError, match="for 2 exposures"):
        merge(np.zeros((3, 2, 2), np.uint16), response.lookup, 4000, [1.0, 2.0])


def _expose(rng: np.random.Generator, radiance: np.ndarray, amount: float, black: float) -> np.ndarray:
    """Poisson electrons, read noise of 3, a well of 10 000, 12 bits."""
    electrons = rng.poisson(np.minimum(radiance * amount * 10_000, 1e6)) + rng.normal(0, 3, radiance.shape)
    codes = np.rint(black + np.minimum(electrons, 10_000) * ((4095 - black) / 10_000))
    return np.clip(codes, 0, 4095).astype(np.uint16)


def _mean_and_noise(radiance: float, amounts: list[float], black: float) -> tuple[float, float]:
    rng, picture = np.random.default_rng(7), np.full((200, 200), radiance)
    codes = np.stack([_expose(rng, picture, amount, black) for amount in amounts])
    response = _response(black_level=black)
    merged, _ = merge(codes, response.lookup, response.saturated_from, amounts)
    return float(merged.mean(dtype=np.float64)), float(merged.std(dtype=np.float64))


@pytest.mark.parametrize("radiance", [0.0005, 0.03, 0.9, 0.97, 0.985, 1.2, 15.0, 200.0])
def test_noise_averages_out_also_near_the_saturation_threshold(radiance: float) -> None:
    mean, noise = _mean_and_noise(radiance, [1.0, 1 / 16, 1 / 256], black=200.0)
    near_threshold = 0.96 < radiance < 1.0
    allowed = 0.006 * radiance if near_threshold else 0.0
    assert abs(mean - radiance) < 5 * noise / 200 + allowed + 1e-5


def test_a_dark_pixel_is_unbiased_with_a_black_level_and_slightly_bright_without() -> None:
    exact, _ = _mean_and_noise(0.0, [1.0, 1 / 16], black=200.0)
    cut, _ = _mean_and_noise(0.0, [1.0, 1 / 16], black=0.0)
    read_noise = 3 / 10_000
    assert abs(exact) < 0.03 * read_noise
    # The mean of the positive half of a normal distribution; rounding to whole codes changes it a little.
    assert cut == pytest.approx(read_noise / np.sqrt(2 * np.pi), rel=0.1)


@pytest.mark.parametrize(("step", "least_share"), [(2, 0.89), (4, 0.91), (16, 0.97)])
@pytest.mark.parametrize("electrons", [0.0, 20.0, 5000.0])
def test_the_noise_stays_near_the_optimum_in_light_and_dark(
    step: int, least_share: float, electrons: float
) -> None:
    # Inverse variances of the linear estimates, by the noise model alone: the best possible ones over those used.
    amounts = 1.0 / step ** np.arange(4)
    variance = electrons * amounts + 9.0
    best = 1 / np.sum(amounts**2 / variance)
    used = np.sum(amounts**2 * variance) / np.sum(amounts**2) ** 2
    assert np.sqrt(best / used) > least_share
    measured = _mean_and_noise(electrons / 10_000, amounts.tolist(), black=200.0)[1] * 10_000
    rounding = (10_000 / 3895) ** 2 / 12 * np.sum(amounts**2) / np.sum(amounts**2) ** 2
    assert measured == pytest.approx(np.sqrt(used + rounding), rel=0.03)

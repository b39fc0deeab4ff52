"""How true a merged bracket is: a room of the virtual lab, seen by a simulated 12-bit sensor with photon and read noise.

The room as it is spans three orders of magnitude; a grey wedge before the lens spreads it over more than five. Truth is compared at two
places: at the samples of the mosaic, which the merge alone answers for, and at the pixels of the developed picture, all three channels,
after demosaicing and half floats. The scene is blurred as by a good lens (0.7 pixels): path-traced pictures are sharper than any
lens, and nobody knows what then lies between the samples of a mosaic.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from nearfield_server.imaging.development import Developer
from nearfield_server.imaging.hdr_merge import merge
from nearfield_server.reference.imaging import demosaicked, mosaic
from nearfield_server.scene.device_schema import SensorTable
from nearfield_server.scene.exr import read_exr

LAB_ROOM = Path(__file__).parents[3] / "server" / "nearfield_server" / "rooms" / "lab"
FULL_WELL, READ_NOISE, BLACK_LEVEL, TOP = 32_000, 5.0, 200, 4095
"""Of a usual sensor of 5.9 um pixels."""
SIDE = 1024


@dataclass(frozen=True)
class Capture:
    """A bracket of a known scene: truth (H, W, 3), circle (H, W), exposure amounts, codes (N, H, W)."""

    truth: np.ndarray
    inside: np.ndarray
    amounts: np.ndarray
    codes: np.ndarray

    @property
    def samples(self) -> np.ndarray:
        return mosaic(self.truth, "RGGB")


def _expose(rng: np.random.Generator, samples: np.ndarray, amount: float) -> np.ndarray:
    """Poisson electrons (a normal variable for many), read noise, full well, 12 bits."""
    expected = np.minimum(samples * amount * FULL_WELL, 10 * FULL_WELL)
    shot = expected + np.sqrt(expected) * rng.standard_normal(expected.shape)
    few = expected < 1000
    shot[few] = rng.poisson(expected[few])
    electrons = shot + READ_NOISE * rng.standard_normal(expected.shape)
    codes = BLACK_LEVEL + np.minimum(electrons, FULL_WELL) * ((TOP - BLACK_LEVEL) / FULL_WELL)
    return np.clip(np.rint(codes), 0, TOP).astype(np.uint16)


@pytest.fixture(scope="module")
def room() -> np.ndarray:
    """(H, W, 3) float64: what camera 0 of the lab sees under its lamps."""
    picture = np.zeros((SIDE, SIDE, 3))
    for index, light in enumerate(json.loads((LAB_ROOM / "scene.json").read_text())["lights"]):
        factors = np.array(light["radiance"]) / light["basis_radiance"]
        picture += factors * read_exr(LAB_ROOM / f"cam0_light{index}.exr")[..., :3]
    return np.maximum(picture, 0.0)


def _capture(room: np.ndarray, step: float, num_exposures: int, brightest: float) -> Capture:
    """`brightest`: of the scene, in the shortest exposure, as a share of the full well."""
    inside = room.mean(-1) > 1e-3
    truth = gaussian_filter(room, (0.7, 0.7, 0)) * np.geomspace(1.0, 10.0**-4.2, SIDE)[:, None]
    amounts = brightest / truth.max() * step ** np.arange(num_exposures)[::-1]
    rng = np.random.default_rng(11)
    samples = mosaic(truth, "RGGB")
    codes = np.stack([_expose(rng, samples, amount) for amount in amounts])
    return Capture(truth, inside, amounts, codes)


@pytest.fixture(scope="module")
def capture(room: np.ndarray) -> Capture:
    return _capture(room, 10.0, 5, 0.9)


TABLE = SensorTable(black_level=BLACK_LEVEL)


def _developed(capture: Capture) -> np.ndarray:
    developer = Developer(TABLE, "BayerRG12", SIDE, SIDE)
    for position, codes in enumerate(capture.codes):
        developer.keep(position, codes.astype("<u2").view(np.uint8).reshape(-1), 0)
    for i, j, ratio in developer.ratios(len(capture.codes)):
        if np.isfinite(ratio):
            assert ratio == pytest.approx(capture.amounts[i] / capture.amounts[j], rel=0.01)
    return developer.merge(capture.amounts.tolist(), np.empty((SIDE, SIDE, 4), np.float16))


def test_the_merge_is_true_within_a_percent_over_five_orders_of_magnitude(capture: Capture) -> None:
    response = Developer(TABLE, "BayerRG12", SIDE, SIDE).response
    found, is_bound = merge(capture.codes, response.lookup, response.saturated_from, capture.amounts)
    assert not is_bound.any()
    truth = capture.samples
    usable = capture.inside & (truth >= truth.max() * 1e-5)
    error = np.abs(found[usable] / truth[usable] - 1)
    assert truth[usable].max() / truth[usable].min() > 0.99e5
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.99) < 0.05
    # Not on average only: in every order of magnitude that has pixels, and without bias.
    for decade in range(5):
        low = truth.max() * 10.0 ** (decade - 5)
        part = usable & (truth >= low) & (truth < 10 * low)
        assert part.sum() > 300
        ratio = found[part] / truth[part]
        assert np.quantile(np.abs(ratio - 1), 0.99) < 0.05
        assert abs(ratio.mean() - 1) < 1e-3 + 5 * ratio.std() / np.sqrt(part.sum())


def test_so_is_the_developed_picture(capture: Capture) -> None:
    found = _developed(capture)
    usable = capture.inside & (found[..., 3] == 1) & (capture.truth.min(-1) >= capture.truth.max() * 1e-5)
    assert usable.sum() > 0.98 * capture.inside.sum()
    error = np.abs(found[usable, :3] / capture.truth[usable] - 1)
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.99) < 0.05
    light = found[usable, :3].astype(float).sum(0) / capture.truth[usable].sum(0)
    np.testing.assert_allclose(light, 1.0, atol=1e-3)


def test_lamps_beyond_the_shortest_exposure_stay_bright_and_marked(room: np.ndarray) -> None:
    capture = _capture(room, 16.0, 3, 8.0)
    found = _developed(capture)
    limit = 0.98 / capture.amounts.min()
    lamp = capture.inside & (capture.truth.min(-1) > 1.1 * limit)
    assert lamp.sum() > 300
    assert (found[lamp, 3] < 1).all()
    # At its edge colours also come from samples that are not full.
    assert (found[lamp, :3] > 0.7 * limit).all()
    assert (found[lamp, :3] > 0.95 * limit).mean() > 0.995
    assert (found[lamp, :3] <= capture.truth[lamp]).mean() > 0.99
    rest = capture.inside & (found[..., 3] == 1)
    bright = rest & (capture.truth.min(-1) > 3e-4 * limit)
    assert np.median(np.abs(found[bright, :3] / capture.truth[bright] - 1)) < 0.01


@pytest.mark.parametrize("bayer", ["RGGB", "GRBG", "GBRG", "BGGR"])
def test_demosaicing_neither_adds_nor_loses_light(room: np.ndarray, bayer: str) -> None:
    # As sharp as it was traced: the hardest case.
    picture = room[300:800, 250:770]
    found = np.maximum(demosaicked(mosaic(picture, bayer), bayer, 1e-4 * picture.max()), 0.0)
    samples = [mosaic(picture, bayer)[row::2, column::2].sum() for row in (0, 1) for column in (0, 1)]
    for channel, name in enumerate("RGB"):
        # What the samples of this colour say of the whole, before anything is interpolated.
        sampled = np.mean([total for total, colour in zip(samples, bayer, strict=True) if colour == name]) * 4
        assert found[..., channel].sum() == pytest.approx(picture[..., channel].sum(), rel=4e-3)
        assert found[..., channel].sum() == pytest.approx(sampled, rel=6e-3)
    error = np.abs(found - picture)[picture > 0] / picture[picture > 0]
    assert np.median(error) < 6e-3


@pytest.mark.parametrize("electrons", [30.0, 100.0, 1000.0])
def test_noise_neither_brightens_nor_tints_a_dark_wall(electrons: float) -> None:
    rng = np.random.default_rng(12)
    colour = np.array([1.0, 0.8, 0.5])
    truth = np.broadcast_to(electrons / FULL_WELL * colour, (512, 512, 3))
    codes = _expose(rng, mosaic(truth, "GRBG"), 1.0)
    developer = Developer(TABLE, "BayerGR12", 512, 512)
    found = developer.develop(
        codes.astype("<u2").view(np.uint8).reshape(-1), 0, 1.0, np.empty((512, 512, 4), np.float16)
    )
    mean = found[..., :3].astype(float).mean((0, 1))
    noise = np.sqrt(electrons * colour + READ_NOISE**2) / electrons / 512 * 2
    # Values below 0 are cut off at the end: a little of the noise of 30 electrons.
    np.testing.assert_allclose(mean / truth[0, 0], 1.0, atol=5 * noise.max() + 0.004)
    assert (
        found[..., :3].astype(float).std((0, 1)).max()
        < 1.15 * np.sqrt(electrons + READ_NOISE**2 + 5) / FULL_WELL
    )

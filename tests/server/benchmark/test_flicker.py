import numpy as np
import pytest

from nearfield_protocol.codec import VAL_DTYPE
from nearfield_server.benchmark.flicker import flicker, val_movement_mm


def test_still_pictures_do_not_flicker() -> None:
    picture = np.random.default_rng(0).random((4, 6, 3))
    assert flicker([picture, picture, picture], 1.0) == 0.0


def test_flicker_is_the_mean_step_on_the_display() -> None:
    # Below 0.0031308 the sRGB transfer function is 12.92 x: a step of 1/255 / 12.92 is one of 1/255 on the display.
    dark, lit = np.zeros((2, 2, 3)), np.zeros((2, 2, 3))
    lit[0] = 0.5 / 255.0 / 12.92
    assert flicker([dark, lit, dark], 2.0) == pytest.approx(0.5, rel=1e-4)
    with pytest.raises(ValueError, match="found 1"):
        flicker([dark], 1.0)


def _vals(places: list[float], generation: int = 0, lit: bool = True) -> np.ndarray:
    vals = np.zeros(len(places), VAL_DTYPE)
    vals["position"][:, 0] = places
    vals["radiant_intensity"] = float(lit)
    vals["generation"] = generation
    return vals


def test_the_furthest_step_of_a_light_that_stays_the_same_one_counts() -> None:
    assert val_movement_mm([_vals([0.0, 1.0]), _vals([0.002, 1.0]), _vals([0.002, 1.003])]) == pytest.approx(
        3.0, rel=1e-3
    )
    assert val_movement_mm([_vals([0.0]), _vals([5.0], generation=1)]) == 0.0
    assert val_movement_mm([_vals([0.0]), _vals([5.0], lit=False)]) == 0.0
    assert val_movement_mm([_vals([]), _vals([1.0])]) == 0.0

"""What nine coefficients do to the sharpest of all lights: ringing, and irradiance below zero, by closed forms.

Clients clamp what they show at zero (`gbuffer_object.vert`, `shade.frag`); nothing before that may, or light would not add up.
"""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nearfield_server.radiometry.sh import irradiance, sh_basis

UNIT = (
    hnp.arrays(np.float64, 3, elements=st.floats(-1, 1))
    .filter(lambda v: np.linalg.norm(v) > 1e-3)
    .map(lambda v: v / np.linalg.norm(v))
)
LOWEST_RADIANCE = -1.8 / (4.0 * np.pi)
"""Of a delta light of 1 W/m^2: (1 + 3 c + 5 (3 c^2 - 1) / 2) / 4 pi, least at c = -1/5."""
LOWEST_IRRADIANCE = -19.0 / 480.0
"""3/32 + c/2 + 15/32 c^2, least at c = -8/15: -4 % of the irradiance on a surface that faces the light, where 0 is right."""
HIGHEST_IRRADIANCE = 17.0 / 16.0
"""At c = 1, where 1 is right."""


def _delta(direction: np.ndarray) -> np.ndarray:
    """(9, 1) coefficients of one watt per square metre from one direction."""
    return sh_basis(direction)[:, None]


@given(UNIT, UNIT)
def test_delta_light_rings_by_its_closed_form(light: np.ndarray, normal: np.ndarray) -> None:
    cosine = float(light @ normal)
    radiance = float(sh_basis(normal) @ _delta(light)[:, 0])
    expected = (1.0 + 3.0 * cosine + 2.5 * (3.0 * cosine**2 - 1.0)) / (4.0 * np.pi)
    np.testing.assert_allclose(radiance, expected, atol=1e-12)
    assert radiance >= LOWEST_RADIANCE - 1e-12
    found = float(irradiance(_delta(light), normal)[0])
    np.testing.assert_allclose(found, 3 / 32 + cosine / 2 + 15 / 32 * cosine**2, atol=1e-12)
    assert LOWEST_IRRADIANCE - 1e-12 <= found <= HIGHEST_IRRADIANCE + 1e-12
    # Against the truth max(0, c): a sixteenth at most, facing the light, and less than a tenth anywhere.
    assert abs(found - max(0.0, cosine)) < 0.1


@given(st.lists(st.tuples(UNIT, st.floats(0, 1e4)), min_size=1, max_size=8), UNIT)
def test_lights_add_up_and_ring_by_no_more_than_their_sum(
    lights: list[tuple[np.ndarray, float]], normal: np.ndarray
) -> None:
    coefficients = sum(weight * _delta(direction) for direction, weight in lights)
    total = sum(weight for _, weight in lights)
    found = float(irradiance(coefficients, normal)[0])
    np.testing.assert_allclose(
        found, sum(w * irradiance(_delta(d), normal)[0] for d, w in lights), rtol=1e-9, atol=1e-9
    )
    assert (LOWEST_IRRADIANCE - 1e-9) * total <= found + 1e-12
    assert found <= (HIGHEST_IRRADIANCE + 1e-9) * total + 1e-12

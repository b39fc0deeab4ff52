import numpy as np
import pytest

from nearfield_server.pipeline.levels import LEVELS, energy_scale, level_energy


@pytest.mark.parametrize("area", [[1e-7], [5e5], [1e-9, 1e3], [0.0, 2.0]])
def test_the_scale_leaves_room_for_the_brightest_room(area: list[float]) -> None:
    areas = np.array(area, dtype=np.float32)
    scale = energy_scale(areas)
    assert np.log2(scale) == np.rint(np.log2(scale))
    assert 65504.0 * float(areas.sum(dtype=np.float64)) * scale <= 2.0**62
    assert 2.0**45 < 65504.0 * float(areas.max()) * scale <= 2.0**51 or areas.size > 1


def test_nothing_has_any_scale() -> None:
    assert energy_scale(np.zeros(4, dtype=np.float32)) == 1.0


def test_energy_lies_at_its_level() -> None:
    radiance = np.array([[1.0, 2.0, 0.0], [1.06, 2.0, 65504.0]], dtype=np.float32)
    area = np.array([0.5, 0.25], dtype=np.float32)
    energy = level_energy(radiance, area, 2.0**40)
    assert energy.shape == (3, LEVELS)
    # Exponent 127 is 1; 1.0 and 1.06 share the first sixteenth of that octave.
    assert np.flatnonzero(energy[0]).tolist() == [127 << 4]
    assert energy[1, 128 << 4] == 3 * 2**39
    assert energy[2].nonzero()[0].tolist() == [(142 << 4) + 15]
    np.testing.assert_allclose(
        energy.sum(axis=1) / 2.0**40, (radiance.astype(np.float64) * area[:, None]).sum(axis=0), rtol=1e-12
    )

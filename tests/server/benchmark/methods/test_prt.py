import numpy as np

from nearfield_server.benchmark.methods.light import AtlasSample, Surroundings
from nearfield_server.benchmark.methods.prt import EnvironmentTransfer


def test_an_even_room_has_only_the_constant_term(around: Surroundings) -> None:
    radiance = np.full((len(around.texels.area), 3), [1.0, 2.0, 3.0], np.float32)
    light = EnvironmentTransfer(around).extract(AtlasSample(frames=(), radiance=radiance))
    assert len(light.vals) == 0
    # 4 pi Y_0 = 2 sqrt(pi)
    np.testing.assert_allclose(
        light.object_sh[:, 0], 2.0 * np.sqrt(np.pi) * np.array([[1, 2, 3]] * 2), rtol=1e-6
    )
    np.testing.assert_allclose(light.object_sh[:, 1:], 0.0, atol=5e-3)

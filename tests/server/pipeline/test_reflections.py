"""A small lamp above a floor: what the floor shows is either what the lamp allows, or more."""

from dataclasses import dataclass

import numpy as np
import pytest

from nearfield_server.pipeline.reflections import (
    REFLECTED_SHARE,
    Reflectors,
    make_reflectors,
    reflected_share,
)
from nearfield_server.reference.box_room import make_box_room

HEIGHT, LAMP_SIDE, RADIANCE, ALBEDO = 1.5, 0.2, 40.0, 0.6


@dataclass
class _Texels:
    """Texels picked by brute force; the numbers of `pipeline.reflections.TexelPicker`."""

    radiance: np.ndarray
    area: np.ndarray

    def pick(self, threshold: np.ndarray) -> np.ndarray:
        weight = (np.where(self.radiance >= threshold, self.radiance, 0.0)).sum(axis=1) * self.area
        cumulative = np.cumsum(weight)
        if not cumulative[-1] > 0.0:
            return np.zeros(0, dtype=np.int64)
        pattern = (np.arange(4096) + 0.5) / 4096
        return np.searchsorted(cumulative, pattern * cumulative[-1], side="right")

    def radiance_of(self, texel: np.ndarray, channel: int) -> np.ndarray:
        return self.radiance[texel, channel]


def _square(side: float, count: int, height: float, up: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    step = (np.arange(count) + 0.5) / count - 0.5
    x, z = np.meshgrid(side * step, side * step)
    position = np.stack([x.ravel(), np.full(x.size, height), z.ravel()], axis=1)
    return position, np.tile([0.0, up, 0.0], (x.size, 1)), np.full(x.size, (side / count) ** 2)


def _scene(gain: float) -> tuple[Reflectors, _Texels]:
    """The floor reflects the lamp's light `gain` times as brightly as its albedo allows; float64 sums over all pairs."""
    lamp, down, lamp_area = _square(LAMP_SIDE, 12, HEIGHT, -1.0)
    floor, up, floor_area = _square(2.0, 40, 0.0, 1.0)
    offset = lamp[None] - floor[:, None]
    squared = (offset**2).sum(axis=2)
    irradiance = RADIANCE * (offset[..., 1] ** 2 / squared**2 * lamp_area).sum(axis=1)
    radiance = np.concatenate([np.full(len(lamp), RADIANCE), gain * ALBEDO / np.pi * irradiance])
    reflectors = Reflectors(
        position=np.concatenate([lamp, floor]).astype(np.float32),
        normal=np.concatenate([down, up]).astype(np.float32),
        albedo=np.full((len(radiance), 3), ALBEDO, dtype=np.float32),
    )
    return reflectors, _Texels(
        np.repeat(radiance[:, None], 3, axis=1), np.concatenate([lamp_area, floor_area])
    )


def _share(reflectors: Reflectors, texels: _Texels) -> float:
    energy, area = RADIANCE * LAMP_SIDE**2, LAMP_SIDE**2
    return reflected_share(reflectors, texels, 1, 0.5 * RADIANCE, 1e-4, energy, area)


@pytest.mark.parametrize("gain", [1.0, 2.0, 20.0])
def test_the_share_is_what_the_lamp_explains(gain: float) -> None:
    assert _share(*_scene(gain)) == pytest.approx(1.0 / gain, rel=0.02)


def test_a_floor_that_shines_is_no_reflection() -> None:
    assert _share(*_scene(1.0)) > REFLECTED_SHARE > _share(*_scene(20.0))


def test_a_lamp_that_looks_away_explains_nothing() -> None:
    reflectors, texels = _scene(1.0)
    normal = reflectors.normal.copy()
    normal[:144] *= -1.0
    turned = Reflectors(position=reflectors.position, normal=normal, albedo=reflectors.albedo)
    assert _share(turned, texels) == 0.0


def test_an_empty_class_is_no_reflection() -> None:
    reflectors, texels = _scene(1.0)
    above = float(texels.radiance[144:].max()) * 1.5
    assert reflected_share(reflectors, texels, 0, 0.5 * RADIANCE, above, 1.6, 0.04) == 0.0


def test_scales_with_room_and_light() -> None:
    reflectors, texels = _scene(1.5)
    expected = _share(reflectors, texels)
    grown = Reflectors(
        position=reflectors.position * np.float32(100.0), normal=reflectors.normal, albedo=reflectors.albedo
    )
    bright = _Texels(texels.radiance * 1e3, texels.area * 1e4)
    energy, area = 1e3 * RADIANCE * LAMP_SIDE**2 * 1e4, LAMP_SIDE**2 * 1e4
    found = reflected_share(grown, bright, 1, 0.5e3 * RADIANCE, 0.1, energy, area)
    assert found == pytest.approx(expected, rel=1e-5)


def test_albedo_follows_the_material() -> None:
    room = make_box_room(atlas_size=24, camera_size=24)
    reflectors = make_reflectors(room.mesh(0.3), room.texels)
    assert reflectors.albedo.shape == room.texels.normal.shape
    np.testing.assert_allclose(reflectors.albedo, 0.3)

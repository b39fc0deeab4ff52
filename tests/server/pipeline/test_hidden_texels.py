import numpy as np

from nearfield_server.pipeline.gather import Atlas, black_atlas, block_maxima
from nearfield_server.pipeline.hidden_light import HiddenLight, estimate_hidden_radiance
from nearfield_server.pipeline.hidden_texels import HiddenTexels, write_hidden_radiance
from nearfield_server.pipeline.levels import level_energy

NUM_TEXELS = 640
NUM_BLOCKS = NUM_TEXELS // 64


def _two_lamps() -> HiddenLight:
    """Two hidden surfaces in blocks 0 and 1, each with seven receivers that also see one visible texel."""
    receivers = np.arange(200, 214, dtype=np.int32)[:, None]
    factor = np.full((14, 2), 1e-3)
    factor[:7, 0] = factor[7:, 1] = 0.1
    return HiddenLight(
        texels=np.array([0, 1, 2, 70], dtype=np.int32),
        group=np.array([0, 0, 0, 1], dtype=np.int32),
        receiver=receivers,
        group_rows=np.array([0, 7, 14]),
        inverse_albedo=np.full((14, 3), np.pi / 0.5),
        form_factor=factor,
        ray_start=np.arange(15, dtype=np.int64),
        ray_texel=np.full(14, 500, dtype=np.int32),
        ray_weight=np.full(14, 0.5, dtype=np.float32),
    )


def _atlas() -> Atlas:
    return black_atlas(np.full(NUM_TEXELS, 0.01, dtype=np.float32))


def test_written_radiance_reaches_texels_and_block_maxima() -> None:
    hidden, atlas = _two_lamps(), _atlas()
    atlas.radiance[:] = 0.5
    atlas.block_max[:] = 0.5
    values = np.array([[1.0, 2.0, 3.0], [0.5, 0.5, 0.5]])
    touched = write_hidden_radiance(hidden.texels, hidden.group, values, atlas.radiance, atlas.block_max)
    np.testing.assert_array_equal(np.flatnonzero(touched), [0])
    np.testing.assert_array_equal(atlas.radiance[:3], np.tile(np.float32([1, 2, 3]), (3, 1)))
    assert (atlas.radiance[3:] == 0.5).all()
    np.testing.assert_array_equal(atlas.block_max, block_maxima(atlas.radiance))
    write_hidden_radiance(hidden.texels, hidden.group, 0.0 * values, atlas.radiance, atlas.block_max)
    np.testing.assert_array_equal(atlas.block_max, block_maxima(atlas.radiance))


def test_skipping_equals_estimating_always() -> None:
    hidden, atlas, always = _two_lamps(), _atlas(), _atlas()
    texels = HiddenTexels(hidden, NUM_BLOCKS)
    rng = np.random.default_rng(1)
    estimates = set()
    for _ in range(400):
        changed = np.zeros(NUM_BLOCKS, dtype=bool)
        if rng.random() < 0.6:
            block = int(rng.choice([3, 5, 7]))
            value = np.float32(rng.choice([0.0, 0.05, 0.06, 0.1, 1.0]))
            for picture in (atlas, always):
                picture.radiance[block * 64 : (block + 1) * 64] = value
                picture.block_max[:] = block_maxima(picture.radiance)
            changed[block] = True
        before = atlas.radiance[hidden.texels].copy()
        asked = changed.copy()
        texels.update(atlas, changed)
        values = estimate_hidden_radiance(hidden, always.radiance)
        write_hidden_radiance(hidden.texels, hidden.group, values, always.radiance, always.block_max)
        np.testing.assert_array_equal(atlas.radiance, always.radiance)
        np.testing.assert_array_equal(atlas.block_max, block_maxima(atlas.radiance))
        differs = (before != atlas.radiance[hidden.texels]).any(axis=1)
        np.testing.assert_array_equal(
            np.flatnonzero(changed & ~asked), np.unique(hidden.texels[differs] // 64)
        )
        picture = atlas.radiance[hidden.texels]
        np.testing.assert_array_equal(
            texels.energy, level_energy(picture, atlas.area[hidden.texels], atlas.energy_scale)
        )
        estimates.add(values.tobytes())
    assert len(estimates) > 3

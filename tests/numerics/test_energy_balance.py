"""No stage makes or loses light, whatever the atlas holds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nearfield_protocol.codec import Encoding, LightPacket, decode_light_packet, encode_light_packet
from nearfield_server.pipeline.blocks import BlockPool, cluster_features, make_blocks
from nearfield_server.pipeline.clustering import empty_state, update_clusters
from nearfield_server.pipeline.gather import block_maxima
from nearfield_server.pipeline.integration import integrate
from nearfield_server.pipeline.levels import energy_scale
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.pipeline.sampling import sample_direct_texels, stratified_pattern
from nearfield_server.pipeline.sh_projection import project_indirect
from nearfield_server.pipeline.split import direct_totals, ratio_threshold
from nearfield_server.radiometry.form_factor import val_irradiance
from nearfield_server.radiometry.sh import irradiance
from nearfield_server.records import CameraFrame, LightSettings, ObjectPose, TexelGeometry
from nearfield_server.reference.box_room import make_box_room

from .conftest import RADIANCES, loose_texels

AXES = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
PATTERN = stratified_pattern(256, 1)


def _single_texel(radiance: list[float]) -> tuple[TexelGeometry, np.ndarray]:
    texels = loose_texels(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]), np.array([1e-8], np.float32))
    return texels, np.array([radiance], np.float32)


@st.composite
def atlases(draw: st.DrawFn) -> tuple[TexelGeometry, np.ndarray]:
    """Texels on a coarse grid (duplicates are likely) that face along the axes, and their radiance."""
    count = draw(st.integers(1, 150))
    position = draw(hnp.arrays(np.int8, (count, 3), elements=st.integers(-3, 3))) * 0.5
    normal = AXES[draw(hnp.arrays(np.int8, count, elements=st.integers(0, 5)))]
    area = draw(hnp.arrays(np.float32, count, elements=st.sampled_from([0.0, 1e-8, 1e-4, 0.0123, 30.0])))
    radiance = draw(hnp.arrays(np.float32, (count, 3), elements=RADIANCES))
    return loose_texels(position, normal, area), radiance


@given(atlases(), st.floats(1e-3, 1.0), st.sampled_from([1, 8, 64]))
@example(_single_texel([1e-38, 6e-8, 6e-8]), 1.0, 1)
@example(_single_texel([1e-38, 1e-38, 1e-38]), 1.0, 1)
def test_lights_hold_the_direct_light_and_lie_among_its_texels(
    atlas: tuple[TexelGeometry, np.ndarray], ratio: float, slots: int
) -> None:
    """Sum I_j = sum L dA of the direct part to 1e-8: also for duplicates, empty clusters and more slots than texels."""
    texels, radiance = atlas
    pool, blocks, maxima = BlockPool(1), make_blocks(texels), block_maxima(radiance)
    threshold = ratio_threshold(radiance, blocks.area, maxima, ratio, pool)
    chosen, total = sample_direct_texels(radiance, blocks.area, threshold, maxima, PATTERN, pool)
    points = cluster_features(blocks.position[chosen], blocks.normal[chosen])
    state = update_clusters(empty_state(slots), points, 20)
    vals = integrate(blocks, radiance, maxima, threshold, state.centres, state.alive, pool)
    direct, everything = direct_totals(radiance, blocks.area, threshold)
    np.testing.assert_allclose(vals.radiant_intensity.sum(axis=0), direct, rtol=1e-8)
    np.testing.assert_allclose(total, direct.mean(), rtol=1e-8)
    # The threshold is chosen from energies that are rounded to whole steps, half a step per texel at most.
    resolution = 0.5 * len(radiance) / energy_scale(blocks.area)
    assert (direct >= ratio * everything * (1.0 - 1e-12) - resolution).all()
    weight = np.where(radiance >= threshold, radiance.astype(np.float64), 0.0).sum(axis=1) * blocks.area
    if direct.any():
        assert (weight[chosen] > 0.0).all()
    for values in (vals.radiant_intensity, vals.position, vals.normal, vals.area, state.centres):
        assert np.isfinite(values).all()
    lit = vals.radiant_intensity.any(axis=1)
    assert lit.sum() <= min(slots, np.unique(points, axis=0).shape[0])
    if lit.any():
        sources = blocks.position[weight > 0.0]
        assert (vals.position[lit] >= sources.min(axis=0) - 1e-6).all()
        assert (vals.position[lit] <= sources.max(axis=0) + 1e-6).all()
        np.testing.assert_allclose(np.linalg.norm(vals.normal[lit], axis=1), 1.0, atol=1e-6)
        assert (vals.area[lit] > 0.0).all()


@given(atlases(), st.floats(1e-3, 1.0))
def test_direct_and_indirect_are_the_atlas(atlas: tuple[TexelGeometry, np.ndarray], ratio: float) -> None:
    """SH of the indirect part and SH of the direct part add up to those of the whole atlas."""
    texels, radiance = atlas
    threshold = ratio_threshold(radiance, texels.area, block_maxima(radiance), ratio, BlockPool(1))
    probe = (np.arange(6 * 4 * 4) % radiance.shape[0]).astype(np.int32)
    infinite = np.full(3, np.inf, dtype=np.float32)
    indirect = project_indirect(probe, 4, radiance, threshold)
    direct = project_indirect(probe, 4, np.where(radiance >= threshold, radiance, np.float32(0.0)), infinite)
    whole = project_indirect(probe, 4, radiance, infinite)
    np.testing.assert_allclose(indirect + direct, whole, rtol=1e-12, atol=1e-12 * np.abs(whole).max())


@pytest.mark.parametrize("radiance", [1e-6, 1.0, 6e4])
def test_white_furnace(radiance: float) -> None:
    """In a room of one radiance L every unoccluded surface receives pi L: through split, SH and the packet."""
    room = make_box_room(atlas_size=48, num_cameras=4, camera_size=64)
    frames = [
        CameraFrame(
            camera_index=index,
            sequence=1,
            content_revision=1,
            timestamp_ns=1,
            pixels=room.picture(index, lambda points, face: np.full((points.shape[0], 3), radiance)),
        )
        for index in range(4)
    ]
    pose = ObjectPose(
        object_index=0,
        revision=1,
        world_from_object=np.eye(4),
        centre_object=np.array([2.0, 1.0, 1.5]),
        radius=0.1,
    )
    pipeline = LightPipeline(
        room.mesh(), room.texels, room.table, LightSettings(), probe_rays=room, backend="cpu"
    )
    update = pipeline.update(frames, [pose])
    assert not update.vals["radiant_intensity"].any()
    given_radiance = float(np.float16(radiance))
    normals = np.random.default_rng(1).normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # 1e-3: the SH Gram error of 64 x 64 point samples per cube face, most of it in band 2.
    np.testing.assert_allclose(irradiance(update.object_sh[0], normals), np.pi * given_radiance, rtol=1e-3)
    packet = LightPacket(
        sequence=1,
        timestamp_ns=1,
        vals=update.vals,
        object_sh=update.object_sh,
        object_revisions=np.ones(1, np.uint32),
        bounds_min=np.zeros(3, np.float32),
        bounds_size=np.full(3, 6.0, np.float32),
    )
    sent = decode_light_packet(encode_light_packet(packet, Encoding.COMPACT)).object_sh[0]
    np.testing.assert_allclose(irradiance(sent, normals), np.pi * given_radiance, rtol=1e-3 + 2.0**-11)


def test_white_furnace_of_the_disc_form() -> None:
    """The same when every texel is a light of its own: the disc form adds up to the hemisphere, near walls as well."""
    room = make_box_room(atlas_size=192, num_cameras=1, camera_size=8)
    texels = room.texels
    rng = np.random.default_rng(2)
    for clearance, tolerance in ((0.2, 0.01), (0.02, 0.08)):
        for _ in range(4):
            point = room.size * rng.uniform(clearance, 1.0 - clearance, 3)
            normal = rng.normal(size=3)
            normal /= np.linalg.norm(normal)
            offset = texels.position - point
            squared = np.einsum("ni,ni->n", offset, offset)
            cosines = np.maximum(offset @ normal, 0.0) * np.maximum(
                -(offset * texels.normal).sum(axis=1), 0.0
            )
            sum_of_discs = (cosines / squared * texels.area / (squared + texels.area / np.pi)).sum()
            assert sum_of_discs == pytest.approx(np.pi, rel=tolerance)


@given(
    hnp.arrays(np.float64, 3, elements=st.floats(-1, 1)),
    st.floats(-12, 3),
    st.floats(-12, 3),
    st.integers(0, 5),
)
def test_no_light_outshines_the_hemisphere_of_its_radiance(
    offset: np.ndarray, distance: float, size: float, facing: int
) -> None:
    """E <= pi I / A however near a receiver comes, also in contact, where Eq. 6 of the paper is singular."""
    area = 10.0**size
    found = val_irradiance(
        10.0**distance * offset[None],
        AXES[facing][None],
        np.zeros(3),
        np.array([0, -1.0, 0]),
        np.array([7.0 * area]),
        area,
    )
    assert 0.0 <= found[0, 0] <= 7.0 * np.pi * (1.0 + 1e-12)

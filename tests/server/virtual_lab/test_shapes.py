from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from nearfield_server.virtual_lab.model import Quad
from nearfield_server.virtual_lab.shapes import (
    FACES,
    box,
    box_face,
    downward_lamp,
    pose,
    transformed,
    wall_with_hole,
)


def enclosed_volume(quads: Sequence[Quad]) -> float:
    """Divergence theorem; positive when the fronts look out."""
    return sum(float((q.p0 + (q.e1 + q.e2) / 2) @ q.normal) * q.area for q in quads) / 3


def total_area_vector(quads: Sequence[Quad]) -> np.ndarray:
    return np.asarray(sum(q.normal * q.area for q in quads))


def test_box_is_closed_and_looks_out() -> None:
    quads = box((0.1, 0.2, -0.3), (0.6, 1.0, 0.4), "m", skip="")
    assert enclosed_volume(quads) == pytest.approx(0.5 * 0.8 * 0.7)
    np.testing.assert_allclose(total_area_vector(quads), 0.0, atol=1e-15)


def test_inward_room_has_negative_volume() -> None:
    quads = [box_face((0, 0, 0), (2, 3, 4), face, "m", inward=True) for face in FACES]
    assert enclosed_volume(quads) == pytest.approx(-24.0)


@pytest.mark.parametrize("face", sorted(FACES))
def test_skip_leaves_out_one_face(face: str) -> None:
    axis, sign = FACES[face]
    kept = {tuple(np.round(q.normal).astype(int)) for q in box((0, 0, 0), (1, 2, 3), "m", skip=face)}
    gone = [0, 0, 0]
    gone[axis] = sign
    assert len(kept) == 5
    assert tuple(gone) not in kept


def test_wall_with_hole_keeps_the_area_around_the_hole() -> None:
    wall = box_face((0, 0, 0), (4, 3, 1), "-z", "m", inward=True)
    parts = wall_with_hole(wall, (1.0, 2.5), (0.5, 1.75))
    assert sum(q.area for q in parts) == pytest.approx(12.0 - 1.5 * 1.25)
    for q in parts:
        np.testing.assert_allclose(q.normal, wall.normal)


def test_lamp_housing_is_closed_and_emits_downwards() -> None:
    lamp = downward_lamp(
        (1, 2, 3), (0.3, 0.2, 0.5), rim=0.02, recess=0.04, material="m", inside="i", emitter="e", light=3
    )
    np.testing.assert_allclose(total_area_vector(lamp), 0.0, atol=1e-15)
    assert enclosed_volume(lamp) == pytest.approx(0.3 * 0.2 * 0.5 - 0.26 * 0.04 * 0.46)
    emitter = [q for q in lamp if q.light == 3]
    assert len(emitter) == 1
    np.testing.assert_allclose(emitter[0].normal, (0, -1, 0))
    assert emitter[0].p0[1] == pytest.approx(2.04)


def test_rigid_transform_keeps_volume() -> None:
    moved = transformed(box((0, 0, 0), (1, 2, 3), "m", skip=""), pose((4, 5, 6), yaw=0.7, roll=-0.4))
    assert enclosed_volume(moved) == pytest.approx(6.0)

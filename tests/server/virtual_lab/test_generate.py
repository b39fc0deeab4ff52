"""The whole generator at tiny sample counts, through the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from nearfield_server.virtual_lab.bundle import choose_points, count_steps
from nearfield_server.virtual_lab.cli import app
from nearfield_server.virtual_lab.model import Scene
from nearfield_server.virtual_lab.presets import choose_quality


def assert_alike(made: Any, expected: Any, place: str) -> None:
    """Equal but for the last bits of floating point, in which processors differ."""
    if isinstance(expected, dict):
        assert made.keys() == expected.keys(), place
        for key in expected:
            assert_alike(made[key], expected[key], f"{place}.{key}")
    elif isinstance(expected, list):
        assert len(made) == len(expected), place
        for index, pair in enumerate(zip(made, expected, strict=True)):
            assert_alike(*pair, f"{place}[{index}]")
    elif isinstance(expected, float):
        assert made == pytest.approx(expected, rel=1e-12, abs=1e-15), place
    else:
        assert made == expected, place


@pytest.mark.lab
def test_preview_of_the_tiny_room_reproduces_the_fixture(backend: object, tmp_path: Path) -> None:
    result = CliRunner().invoke(
        app, ["generate", "--preset", "tiny", "--quality", "preview", "--out", str(tmp_path)]
    )
    assert result.exit_code == 0, result.output
    shipped = Path(__file__).parents[2] / "data" / "tiny_room"
    made, expected = (json.loads((folder / "scene.json").read_text()) for folder in (tmp_path, shipped))
    for key in ("lights", "objects", "cameras", "views", "materials", "sequences", "uv_atlas"):
        assert_alike(made[key], expected[key], key)
    for name in ("room.glb", "ball.glb"):
        assert (tmp_path / name).read_bytes() == (shipped / name).read_bytes()
    with np.load(tmp_path / "points.npz") as coarse, np.load(shipped / "points.npz") as fine:
        np.testing.assert_array_equal(coarse["position"], fine["position"])
        expected_mean = fine["with_direct"].mean(axis=0)
        np.testing.assert_allclose(coarse["with_direct"].mean(axis=0), expected_mean, rtol=0.02)


def test_lab_without_models_says_what_to_do(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["generate", "--preset", "lab", "--out", str(tmp_path)])
    assert result.exit_code == 1
    assert "npm pack" in result.output


def test_points_are_distinct_vertices_of_every_object(tiny_scene: Scene) -> None:
    positions, normals, owner = choose_points(tiny_scene)
    assert len(np.unique(positions, axis=0)) == len(positions) == len(owner)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


def test_step_count_matches_the_sample_counts(tiny_scene: Scene) -> None:
    quality = choose_quality("tiny", "preview")
    expected = (
        2 * (quality.cell_points + quality.point_samples + quality.view_samples) + 2 * quality.camera_samples
    )
    assert count_steps(tiny_scene, quality) == expected

"""`nearfield evaluate` on the shipped tiny bundle: what the report holds, and what happens when parts are missing or wrong."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.evaluation.evaluate import check_settings, evaluate_bundle, load_points
from nearfield_server.scene.bundle import load_bundle


@pytest.fixture(scope="module")
def caches(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NEARFIELD_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def report(tiny_room, tmp_path_factory, caches):
    out = tmp_path_factory.mktemp("report")
    said = []
    found = evaluate_bundle(tiny_room, out, preset="preview", with_views=False, progress=said.append)
    return found, out, said


def test_the_report_has_exactly_its_parts_and_is_valid_json(report):
    found, out, said = report
    assert list(found) == ["irradiance", "views", "atlas", "packet_bytes", "stage_ms", "settings"]
    assert list(found["irradiance"]) == ["rel_rmse", "bias", "median_rel"]
    assert list(found["atlas"]) == ["total_energy_error", "spurious_energy"]
    assert found["views"] == []
    assert json.loads((out / "report.json").read_text()) == found
    assert "Irradiance" in (out / "index.html").read_text()
    assert said


def test_numbers_are_finite_and_costs_are_measured(report):
    found, _, _ = report
    numbers = [*found["irradiance"].values(), *found["atlas"].values(), *found["stage_ms"].values()]
    assert np.isfinite(numbers).all()
    assert found["atlas"]["total_energy_error"] < 0.05
    assert {"gather", "integrate", "sh", "update", "moved_update", "skipped_update"} <= set(found["stage_ms"])
    assert found["stage_ms"]["skipped_update"] < found["stage_ms"]["update"]
    assert 100 < found["packet_bytes"] < 1000


def test_settings_say_how_it_was_made(report):
    settings = report[0]["settings"]
    assert settings["lighting"] == "nominal"
    assert settings["vals"] == 16
    assert settings["ratio"] is None
    assert settings["versions"]["nearfield"]
    assert settings["exposure"] > 0.0


def test_a_bundle_without_truth_is_still_evaluated(tiny_room, tmp_path, caches):
    bundle = tmp_path / "bundle"
    shutil.copytree(tiny_room, bundle)
    scene = json.loads((bundle / "scene.json").read_text())
    for name in ("points.npz", "cells.npz"):
        (bundle / name).unlink()
    scene["sequences"] = []
    (bundle / "scene.json").write_text(json.dumps(scene))
    found = evaluate_bundle(
        bundle, tmp_path / "out", num_vals=8, split_ratio=0.7, preset="preview", with_views=False
    )
    assert found["irradiance"] is None
    assert found["atlas"] is None
    assert found["settings"]["vals"] == 8
    with pytest.raises(ConfigError, match="no sequences"):
        evaluate_bundle(bundle, tmp_path / "out", lighting="dusk:3", with_views=False)


def test_wrong_settings_are_refused_in_words(tiny_room, tmp_path):
    for vals in (0, 65):
        with pytest.raises(ConfigError, match="--vals"):
            check_settings(vals, None)
    for ratio in (0.0, 1.5, float("nan")):
        with pytest.raises(ConfigError, match="--ratio"):
            check_settings(16, ratio)
    with pytest.raises(AssetError, match=r"scene\.json"):
        evaluate_bundle(tmp_path, tmp_path / "out")
    sequence = load_bundle(tiny_room).sequences[0]
    with pytest.raises(ConfigError, match=sequence.name):
        evaluate_bundle(tiny_room, tmp_path / "out", lighting="moon:0")


def test_points_are_sums_over_lights_and_objects_are_found_by_name(tiny_room, tmp_path):
    bundle = load_bundle(tiny_room)
    radiance = np.array([light.radiance for light in bundle.lights])
    count = len(bundle.lights)
    rng = np.random.default_rng(4)
    direct, indirect = rng.random((5, count)), rng.random((5, count, 3))
    path = tmp_path / "points.npz"
    arrays = {
        "position": rng.random((5, 3)),
        "normal": np.tile([0.0, 1, 0], (5, 1)),
        "object": np.zeros(5, np.int64),
        "object_names": np.array([bundle.objects[0].name]),
        "with_direct": direct,
        "with_indirect": indirect,
    }
    np.savez(path, **arrays)
    weights = np.linspace(0.5, 2.0, count)
    _, _, index, truth = load_points(path, bundle, weights)
    expected = sum(
        w * r * (direct[:, k, None] + indirect[:, k])
        for k, (w, r) in enumerate(zip(weights, radiance, strict=True))
    )
    np.testing.assert_allclose(truth, expected)
    assert index.tolist() == [0] * 5
    np.savez(path, **{**arrays, "object_names": np.array(["ghost"])})
    with pytest.raises(AssetError, match="ghost"):
        load_points(path, bundle, weights)
    np.savez(path, **{**arrays, "with_direct": direct[:, :1]})
    with pytest.raises(AssetError, match="with_direct"):
        load_points(path, bundle, weights)

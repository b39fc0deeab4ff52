import json

import numpy as np
import pytest

from nearfield_server.benchmark.scenario import box_scenario, noisy_frames, with_changed_tiles
from nearfield_server.benchmark.server_times import measure
from nearfield_server.pipeline.runner import STAGES
from nearfield_server.records import FRAME_TILE, LightSettings

RATIOS = (
    "update_over_copy",
    "update_over_byte_limit",
    "numpy_over_update",
    "unchanged_over_full",
    "dirty1_over_full_gather",
)


def test_report_holds_every_stage_and_ratio() -> None:
    report = measure(box_scenario(96), LightSettings(num_samples=256), "cpu", 4)
    assert tuple(report["stages"]) == STAGES
    for name in RATIOS:
        assert report[name] > 0.0
        assert report["spread"][name]["lower_quartile"] <= report[name]
        assert report["spread"][name]["upper_quartile"] >= report[name]
    assert {"gather", "split", "sh"} <= set(report["stage_cpu_ms"])
    for name, row in report["stages"].items():
        assert row == {} or row["copies"] == pytest.approx(row["cpu_ms"] / report["copy_67_mb"]["cpu_ms"]), (
            name
        )
    assert report["bytes"]["update"] == sum(
        report["bytes"][name] for name in ("gather", "split", "sample", "cluster", "integrate", "sh")
    )
    assert report["backend"] == "cpu"
    assert report["unchanged_us"] > 0.0
    assert 0.0 < report["dirty1"]["blocks_share"] <= 1.0
    json.dumps(report)


def test_noise_gives_every_round_new_pictures() -> None:
    scenario = box_scenario(48)
    first, second = noisy_frames(scenario, 0), noisy_frames(scenario, 1)
    assert not np.array_equal(first[0].pixels, second[0].pixels)
    assert np.isfinite(first[0].pixels).all()
    assert (first[0].tile_revisions != second[0].tile_revisions).all()


def test_tiles_change_where_their_revision_says() -> None:
    scenario = box_scenario(48, camera_size=200)
    frames, other = noisy_frames(scenario, 0), noisy_frames(scenario, 1)
    changed, share = with_changed_tiles(frames, other, 0.1, 3)
    assert share == pytest.approx(5 / 49)
    for old, new in zip(frames, changed, strict=True):
        differs = (old.pixels != new.pixels).any(axis=2)
        rows, columns = np.nonzero(old.tile_revisions != new.tile_revisions)
        assert rows.size == 5
        for row, column in zip(rows, columns, strict=True):
            differs[
                row * FRAME_TILE : (row + 1) * FRAME_TILE, column * FRAME_TILE : (column + 1) * FRAME_TILE
            ] = False
        assert not differs.any()

"""The client benchmark: statistics, and a tiny round of every variant in a real browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from nearfield_server.benchmark.client_page import BenchPage, FrameCost, open_bench_page, require_built_page
from nearfield_server.benchmark.client_scene import ClientScene
from nearfield_server.benchmark.client_times import (
    EXTRA_RATIOS,
    RATIOS,
    Plan,
    make_variants,
    measure_on,
    summarise,
)
from nearfield_server.errors import ServiceError

FEW, MANY = 2, 4
SIZE = (96, 54)


def _costs(*values: float) -> list[FrameCost]:
    return [FrameCost(gpu_cpu_ms=value, page_cpu_ms=0.1, wall_ms=2.0 * value) for value in values]


def test_ratios_are_medians_of_the_rounds() -> None:
    costs = {
        "ours16": _costs(1.0, 2.0, 9.0),
        "three16": _costs(2.0, 8.0, 10.0),
        "other": _costs(4.0, 5.0, 6.0),
    }
    result = summarise(costs, {"first": ("ours16", "three16"), "absent": ("ours16", "ours64")})
    assert result["first"] == pytest.approx(0.5)
    assert result["spread"]["first"]["upper_quartile"] == pytest.approx(0.7)
    assert "absent" not in result
    assert result["wall_ratios"] == {"first": pytest.approx(0.5)}
    assert result["cpu_ms"] == {"ours16": 2.0, "three16": 8.0, "other": 5.0}


def test_every_ratio_names_variants() -> None:
    known = make_variants(16, 64)
    assert {side for pair in (RATIOS | EXTRA_RATIOS).values() for side in pair} <= set(known)


def test_a_missing_page_is_explained(tmp_path: Path) -> None:
    with pytest.raises(ServiceError, match="npm run build:bench"):
        require_built_page(tmp_path)


def _decode(png: bytes) -> NDArray[np.int16]:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture.astype(np.int16)


def _share_that_differs(a: NDArray[np.int16], b: NDArray[np.int16]) -> float:
    """Share of pixels that differ by more than rounding."""
    return float((np.abs(a - b).max(axis=-1) > 4).mean())


def _check_picture(page: BenchPage, maker: str, packet: bytes, exposure: float) -> None:
    pictures = {}
    for name, drawing in (
        ("whole", {}),
        ("unshadowed", {"shadows": False}),
        ("unlit", {"shadows": False, "lights": False}),
    ):
        page.create(name, maker, packet, exposure, **drawing)
        pictures[name] = _decode(page.picture(name))
        page.remove(name)
    whole = pictures["whole"]
    assert whole.shape == (SIZE[1], SIZE[0], 3)
    assert np.median(whole) > 20, maker
    assert _share_that_differs(whole, pictures["unlit"]) > 0.02, maker
    assert _share_that_differs(whole, pictures["unshadowed"]) > 0.002, maker
    # Shadows only take light away.
    assert whole.mean() < pictures["unshadowed"].mean(), maker


@pytest.mark.browser
def test_every_renderer_draws_lights_and_shadows(tiny_scene: ClientScene, built_page: Path) -> None:
    with open_bench_page(tiny_scene, "llvmpipe", *SIZE, static_dir=built_page) as page:
        for maker in ("ours", "three", "differential", "playcanvas"):
            _check_picture(page, maker, tiny_scene.packets[MANY], tiny_scene.exposure)


@pytest.mark.browser
def test_a_round_times_every_variant(tiny_scene: ClientScene, built_page: Path, tmp_path: Path) -> None:
    variants = make_variants(FEW, MANY)
    plan = Plan(rounds=1, frames=1, width=SIZE[0], height=SIZE[1])
    report: dict[str, Any] = measure_on(
        tiny_scene, "llvmpipe", variants, plan, tmp_path, lambda _: None, static_dir=built_page
    )
    json.dumps(report)
    for name in RATIOS | EXTRA_RATIOS:
        assert np.isfinite(report[name])
        assert report[name] > 0.0
        assert report["spread"][name]["count"] == 1
    for part in ("cpu_ms", "page_cpu_ms", "wall_ms"):
        assert set(report[part]) == set(variants)
        assert min(report[part].values()) >= 0.0
    assert set(report["vals"]) == {variant.key for variant in variants.values()}
    assert {path.name for path in tmp_path.iterdir()} == {
        f"client_llvmpipe_{key}.png" for key in report["vals"]
    }

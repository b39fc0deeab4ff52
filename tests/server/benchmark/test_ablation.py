"""Each ingredient that is left out really is, and the table says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from nearfield_server.benchmark.ablation import INGREDIENTS, measure_ablation

TINY = Path(__file__).parents[2] / "data" / "tiny_room"


@pytest.fixture(scope="module")
def rows() -> dict[str, dict[str, object]]:
    return {
        str(row["without"]): row for row in measure_ablation(TINY, True, lambda text: None, with_views=False)
    }


def test_one_row_per_ingredient_and_the_whole_first(rows: dict[str, dict[str, object]]) -> None:
    assert list(rows) == [ingredient.name for ingredient in INGREDIENTS]
    assert next(iter(rows)) == "nothing left out"
    assert all(row["bytes"] > 0 and row["server_cpu_ms"] > 0.0 for row in rows.values())


def test_without_indirect_light_the_object_is_too_dark(rows: dict[str, dict[str, object]]) -> None:
    assert rows["indirect light"]["irradiance_bias"] < rows["nothing left out"]["irradiance_bias"] - 0.1


@pytest.mark.parametrize("name", ["ground shadow", "lights as discs", "split in a gap of the histogram"])
def test_leaving_it_out_changes_the_error(rows: dict[str, dict[str, object]], name: str) -> None:
    assert rows[name]["irradiance_rel_rmse"] != rows["nothing left out"]["irradiance_rel_rmse"]


def test_a_convex_object_does_not_light_itself(rows: dict[str, dict[str, object]]) -> None:
    whole = rows["nothing left out"]["irradiance_rel_rmse"]
    assert rows["self-interreflection"]["irradiance_rel_rmse"] == pytest.approx(whole, rel=1e-3)


@pytest.mark.parametrize("name", ["indirect exchange", "fixture rays"])
def test_parts_of_the_renderer_change_no_irradiance(rows: dict[str, dict[str, object]], name: str) -> None:
    assert rows[name]["irradiance_rel_rmse"] == rows["nothing left out"]["irradiance_rel_rmse"]

"""What Prometheus is told about the light stages."""

from __future__ import annotations

from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from nearfield_server.gateway.metrics import GatewayMetrics


def samples(metrics: GatewayMetrics) -> dict[tuple[str, ...], float]:
    families = text_string_to_metric_families(metrics.render().decode())
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in families
        for sample in family.samples
        if sample.name.startswith(("nearfield_stage", "nearfield_skipping"))
    }


def test_the_account_of_the_stages_is_read_when_somebody_asks() -> None:
    asked = 0
    statuses: dict[str, Any] = {"cam0": {"frames": 1}}

    def newest() -> dict[str, Any]:
        nonlocal asked
        asked += 1
        return statuses

    metrics = GatewayMetrics()
    metrics.watch_stages(newest)
    assert asked == 0
    assert samples(metrics) == {}
    statuses["illumination"] = {
        "stages": [
            {
                "name": "gather",
                "updates_full": 3,
                "updates_part": 2,
                "updates_skipped": 90,
                "spent_total_ms": 250.0,
                "saved_total_ms": 4500.0,
            }
        ],
        "skipping": {"error_bound": 0.01},
    }
    expected = {
        ("nearfield_stage_updates_total", "full", "gather"): 3.0,
        ("nearfield_stage_updates_total", "part", "gather"): 2.0,
        ("nearfield_stage_updates_total", "skipped", "gather"): 90.0,
        ("nearfield_stage_cpu_seconds_total", "gather"): 0.25,
        ("nearfield_stage_saved_cpu_seconds_total", "gather"): 4.5,
        ("nearfield_skipping_error_bound",): 0.01,
    }
    assert samples(metrics) == pytest.approx(expected)

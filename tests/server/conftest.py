"""A made-up benchmark run, for the tests of what is made of one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest


@pytest.fixture(scope="session")
def made_up_run() -> Callable[[], dict[str, Any]]:
    """Makes the content of a bench.json, new each time."""
    return _made_up_run


def _made_up_run() -> dict[str, Any]:
    """The content of a bench.json."""
    from nearfield_server.benchmark.methods import METHODS

    rows = [
        {
            "bundle": "room <1>",
            "name": name,
            "lights": lights,
            "irradiance_rel_rmse": 0.4 / (1 + lights),
            "object_rel_rmse": 0.3,
            "shadow_rel_rmse": None if name == "prt_only" else 0.5,
            "flip": 0.1,
            "flicker": 0.2,
            "server_ms": 20.0,
            "client_ms": 100.0 + lights,
            "bytes": 140 + 16 * lights,
        }
        for name, entry in METHODS.items()
        for lights in entry.light_counts
    ]
    curve = {"x": [1, 2, 4], "cpu_ms": [1.0, 2.0, 4.0], "exponent": 1.0}
    return {
        "format": 1,
        "machine": {"cpus": 2, "processor": "any"},
        "versions": {"python": "3"},
        "parts": {"server": {"state": "done", "reason": ""}},
        "server": {"update_over_copy": 5.0, "stage_cpu_ms": {"gather": 10.0, "sh": 0.5}},
        "capture": {
            "picture": "8 x 8, <any>",
            "cpu_ms": {"copy": 1.0, "record_raw": 7.0},
            "to_copy": {
                "record_raw": 7.0,
                "spread": {
                    "record_raw": {"median": 7.0, "lower_quartile": 6.0, "upper_quartile": 8.0, "count": 5}
                },
            },
            "bytes_per_pixel": {"raw": 3.0},
            "errors": {"merge": {"median": 0.01}},
            "raw_bits_changed": 0,
        },
        "client": {
            "frame_over_three16": 0.5,
            "rasterisers": {
                "llvmpipe": {
                    "frame_over_three16": 0.5,
                    "spread": {
                        "frame_over_three16": {
                            "median": 0.5,
                            "lower_quartile": 0.45,
                            "upper_quartile": 0.55,
                            "count": 9,
                        }
                    },
                }
            },
        },
        "methods": rows,
        "growth": {"server_objects": curve, "screen_pixels": {**curve, "x": [129600, 518400, 1166400]}},
        "ablation": [{"bundle": "room <1>", "without": "indirect light", "irradiance_rel_rmse": 0.7}],
        "temporal": {"rooms": [{"scene": "box", "irradiance_flicker": 0.001, "noise": {"updates": 30}}]},
        "latency": {"missing": "no browser <here>"},
    }

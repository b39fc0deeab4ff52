"""What every stage of the light pipeline costs, next to plain numpy and to memory bandwidth.

All figures of a run come from interleaved rounds of the same process, so that their ratios hold on a busy machine too.
CPU time is that of all threads.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from statistics import median
from typing import Any, Final

import numpy as np

from nearfield_server.benchmark.scenario import Scenario, noisy_frames
from nearfield_server.pipeline.runner import STAGES, BackendName, LightPipeline
from nearfield_server.records import CameraFrame, LightSettings, LightUpdate

_COPY_BYTES: Final = 1 << 25
"""np.copyto of 32 MiB reads and writes 67 MB: the yardstick of memory bandwidth."""
_PARTS: Final = ("wall_ms", "cpu_ms")
_UNCHANGED_CALLS: Final = 1000


def measure(scenario: Scenario, settings: LightSettings, backend: BackendName, rounds: int) -> dict[str, Any]:
    """Run all rounds and summarise them.

    Args:
        scenario: room and pictures.
        settings: of the light extraction.
        backend: of the pipeline under test.
        rounds: interleaved rounds; plain numpy takes part in every third one.

    Returns:
        The content of bench.json.
    """
    fast = _make(scenario, settings, backend)
    plain = _make(scenario, settings, "reference")
    frames = [noisy_frames(scenario, seed) for seed in range(2)]
    started = time.perf_counter()
    fast.update(_with_revision(frames[0], -1), scenario.objects)
    first_ms = (time.perf_counter() - started) * 1e3
    # The second update compiles what only a warm start needs.
    fast.update(_with_revision(frames[1], -2), scenario.objects)
    source, target = np.ones(_COPY_BYTES // 4, np.float32), np.empty(_COPY_BYTES // 4, np.float32)
    samples: dict[str, list[tuple[float, float]]] = {}
    for number in range(rounds):
        _note(samples, "copy", _time(partial(np.copyto, target, source)))
        newest = _with_revision(frames[number % 2], number)
        full = partial(fast.update, newest, scenario.objects)
        _note_update(samples, "stage", "update", full)
        _note(samples, "unchanged", _time(partial(_repeat, full)))
        moved = (replace(scenario.objects[0], revision=number + 10), *scenario.objects[1:])
        _note_update(samples, "moved", "object moved", partial(fast.update, newest, moved))
        full()
        if number % 3 == 0:
            _note_update(samples, "numpy", "numpy", partial(plain.update, newest, scenario.objects))
    return _summary(scenario, settings, fast.backend_name, rounds, first_ms, samples)


def _repeat(update: Callable[[], LightUpdate]) -> None:
    for _ in range(_UNCHANGED_CALLS):
        update()


def _make(scenario: Scenario, settings: LightSettings, backend: BackendName) -> LightPipeline:
    return LightPipeline(
        scenario.mesh,
        scenario.texels,
        scenario.table,
        settings,
        probe_rays=scenario.probes,
        backend=backend,
        unseen_fill=scenario.unseen_fill,
        hidden_light=scenario.hidden_light,
    )


def _time(action: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    action()
    return (time.perf_counter() - wall) * 1e3, (time.process_time() - cpu) * 1e3


def _note(samples: dict[str, list[tuple[float, float]]], name: str, value: tuple[float, float]) -> None:
    samples.setdefault(name, []).append(value)


def _note_update(
    samples: dict[str, list[tuple[float, float]]], prefix: str, name: str, action: Callable[[], LightUpdate]
) -> None:
    wall, cpu = time.perf_counter(), time.process_time()
    update = action()
    _note(samples, name, ((time.perf_counter() - wall) * 1e3, (time.process_time() - cpu) * 1e3))
    for stage in update.stages:
        if stage.ran:
            _note(samples, f"{prefix} {stage.name}", (stage.wall_ms, stage.cpu_ms))


def _summary(
    scenario: Scenario,
    settings: LightSettings,
    backend: str,
    rounds: int,
    first_ms: float,
    samples: dict[str, list[tuple[float, float]]],
) -> dict[str, Any]:
    medians = {
        name: dict(zip(_PARTS, (median(part) for part in zip(*values, strict=True)), strict=True))
        for name, values in samples.items()
    }
    copy_cpu = medians["copy"]["cpu_ms"]

    def row(fast: str, plain: str) -> dict[str, float | None]:
        own = medians.get(fast) or medians.get(fast.replace("stage", "moved"))
        if own is None:
            return {}
        numpy_cpu = medians[plain]["cpu_ms"] if plain in medians else None
        return {
            **own,
            "copies": own["cpu_ms"] / copy_cpu,
            "numpy_cpu_ms": numpy_cpu,
            "times_faster_than_numpy": None if numpy_cpu is None else numpy_cpu / max(own["cpu_ms"], 1e-6),
        }

    stages = {name: row(f"stage {name}", f"numpy {name}") for name in STAGES}
    unchanged_us = medians["unchanged"]["wall_ms"] * 1e3 / _UNCHANGED_CALLS
    update = row("update", "numpy")
    return {
        "scene": {
            "name": scenario.name,
            "atlas": [scenario.texels.width, scenario.texels.height],
            "texels": int(scenario.texels.area.shape[0]),
            "pairs": int(scenario.table.pixel.shape[0]),
            "cameras": [list(shape) for shape in scenario.table.camera_shapes],
            "objects": len(scenario.objects),
            "vals": settings.num_vals,
            "split_ratio": settings.split_ratio,
        },
        "machine": {
            "cpus": len(os.sched_getaffinity(0)),
            "processor": platform.machine(),
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
        "backend": backend,
        "rounds": rounds,
        "first_update_ms": first_ms,
        "copy_67_mb": medians["copy"],
        "update": update,
        "stages": stages,
        "object_moved": row("object moved", ""),
        "unchanged_us": unchanged_us,
        "unchanged_share_of_update": unchanged_us / (1e3 * medians["update"]["wall_ms"]),
    }


def _with_revision(frames: Sequence[CameraFrame], revision: int) -> tuple[CameraFrame, ...]:
    return tuple(replace(frame, content_revision=revision, sequence=revision) for frame in frames)

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
from typing import Any, Final

import numpy as np

from nearfield_server.benchmark.ratios import ratio_spread, spread
from nearfield_server.benchmark.scenario import Scenario, noisy_frames, with_changed_tiles
from nearfield_server.benchmark.server_bytes import update_bytes
from nearfield_server.pipeline.runner import STAGES, BackendName, LightPipeline
from nearfield_server.records import CameraFrame, LightSettings, LightUpdate

_COPY_BYTES: Final = 1 << 25
_COPY_TRAFFIC: Final = 2 * _COPY_BYTES
"""np.copyto of 32 MiB reads and writes 67 MB: the yardstick of memory bandwidth."""
_UNCHANGED_CALLS: Final = 1000
_DIRTY_SHARE: Final = 0.01
_NUMPY_EVERY: Final = 3
_TINY_MS: Final = 1e-6
"""Clocks tick: a cost below that counts as that."""

_Samples = dict[str, list[tuple[float, float]]]
"""Per name and round: wall and CPU milliseconds."""


def measure(scenario: Scenario, settings: LightSettings, backend: BackendName, rounds: int) -> dict[str, Any]:
    """Run all rounds and summarise them.

    Args:
        scenario: room and pictures.
        settings: of the light extraction.
        backend: of the pipeline under test.
        rounds: interleaved rounds; plain numpy takes part in every third one.

    Returns:
        The section `server` of bench.json: ratios (medians over the rounds, their quartiles under `spread`), CPU time by stage,
        and what they were made of. `dirty1` is an update in which one per cent of the tiles of every picture changed, anywhere;
        it is compared with the gather of the same round.
    """
    bench = _Bench(scenario, settings, backend)
    for number in range(rounds):
        bench.round(number)
    return bench.report(rounds)


class _Bench:
    """Both pipelines, the pictures, and the samples taken so far."""

    def __init__(self, scenario: Scenario, settings: LightSettings, backend: BackendName) -> None:
        self._scenario, self._settings = scenario, settings
        self._fast = _make(scenario, settings, backend)
        self._plain = _make(scenario, settings, "reference")
        self._frames = [noisy_frames(scenario, seed) for seed in range(2)]
        other = noisy_frames(scenario, 2)
        changed = [with_changed_tiles(self._frames[k], other, _DIRTY_SHARE, k) for k in range(2)]
        self._dirty, self._dirty_share = [frames for frames, _ in changed], changed[0][1]
        self._source = np.ones(_COPY_BYTES // 4, np.float32)
        self._target = np.empty(_COPY_BYTES // 4, np.float32)
        self._samples: _Samples = {}
        self._dirty_part: list[float] = []
        started = time.perf_counter()
        self._fast.update(_with_revision(self._frames[0], -1), scenario.objects)
        self._first_ms = (time.perf_counter() - started) * 1e3
        # The next ones compile what only a warm start and a partial gather need.
        self._fast.update(_with_revision(self._frames[1], -2), scenario.objects)
        self._last = self._fast.update(_with_revision(self._dirty[1], -3), scenario.objects)
        self._bytes = update_bytes(scenario, settings, self._fast.texel_radiance, self._last.threshold)

    def round(self, number: int) -> None:
        """One round of everything."""
        objects = self._scenario.objects
        self._note("copy", partial(np.copyto, self._target, self._source))
        newest = _with_revision(self._frames[number % 2], 2 * number)
        full = partial(self._fast.update, newest, objects)
        self._note_update("stage", "update", full)
        self._note("copy after", partial(np.copyto, self._target, self._source))
        self._note("unchanged", partial(_repeat, full))
        dirty = _with_revision(self._dirty[number % 2], 2 * number + 1)
        update = self._note_update("dirty1", "dirty1 update", partial(self._fast.update, dirty, objects))
        self._dirty_part.append(update.stages[0].part)
        moved = (replace(objects[0], revision=number + 10), *objects[1:])
        self._note_update("moved", "object moved", partial(self._fast.update, dirty, moved))
        self._fast.update(dirty, objects)
        if number % _NUMPY_EVERY == 0:
            self._note_update("numpy", "numpy", partial(self._plain.update, newest, objects))

    def _note(self, name: str, action: Callable[[], object]) -> None:
        wall, cpu = time.perf_counter(), time.process_time()
        action()
        cost = (time.perf_counter() - wall) * 1e3, (time.process_time() - cpu) * 1e3
        self._samples.setdefault(name, []).append(cost)

    def _note_update(self, prefix: str, name: str, action: Callable[[], LightUpdate]) -> LightUpdate:
        result: list[LightUpdate] = []
        self._note(name, lambda: result.append(action()))
        for stage in result[0].stages:
            if stage.ran:
                cost = (stage.wall_ms, stage.cpu_ms)
                self._samples.setdefault(f"{prefix} {stage.name}", []).append(cost)
        return result[0]

    def report(self, rounds: int) -> dict[str, Any]:
        """Section of bench.json."""
        medians = {
            name: {
                "wall_ms": spread([s[0] for s in values]).median,
                "cpu_ms": spread([s[1] for s in values]).median,
            }
            for name, values in self._samples.items()
        }
        spreads = self._ratios()
        stages = {name: self._row(medians, f"stage {name}", f"numpy {name}") for name in STAGES}
        stages["probe"] = self._row(medians, "moved probe", "numpy probe")
        return {
            **{name: values["median"] for name, values in spreads.items()},
            "update_wall_ms": medians["update"]["wall_ms"],
            "unchanged_us": medians["unchanged"]["wall_ms"] * 1e3 / _UNCHANGED_CALLS,
            "stage_cpu_ms": {name: row["cpu_ms"] for name, row in stages.items() if row},
            "spread": spreads,
            "bytes": {**self._bytes, "update": sum(self._bytes.values()), "copy": _COPY_TRAFFIC},
            "dirty1": {
                "tiles_share": self._dirty_share,
                "blocks_share": spread(self._dirty_part).median,
                "gather_cpu_ms": medians["dirty1 gather"]["cpu_ms"],
                "update": medians["dirty1 update"],
            },
            "copy_67_mb": medians["copy"],
            "update": self._row(medians, "update", "numpy"),
            "object_moved": medians["object moved"],
            "stages": stages,
            "first_update_ms": self._first_ms,
            "scene": self._scene(),
            "machine": _machine(),
            "backend": self._fast.backend_name,
            "rounds": rounds,
        }

    def _cpu(self, name: str) -> list[float]:
        return [max(cpu, _TINY_MS) for _, cpu in self._samples[name]]

    def _ratios(self) -> dict[str, dict[str, float | int]]:
        """Ratios of the costs of the same rounds."""
        update, gather = self._cpu("update"), self._cpu("stage gather")
        # The yardstick is held to the update from both sides.
        copy = [0.5 * (a + b) for a, b in zip(self._cpu("copy"), self._cpu("copy after"), strict=True)]
        limit = sum(self._bytes.values()) / _COPY_TRAFFIC
        unchanged = [cost / _UNCHANGED_CALLS for cost in self._cpu("unchanged")]
        ratios = {
            "update_over_copy": ratio_spread(update, copy),
            "update_over_byte_limit": ratio_spread(update, [cost * limit for cost in copy]),
            "numpy_over_update": ratio_spread(self._cpu("numpy"), update[::_NUMPY_EVERY]),
            "unchanged_over_full": ratio_spread(unchanged, update),
            "dirty1_over_full_gather": ratio_spread(self._cpu("dirty1 gather"), gather),
            "dirty1_update_over_full": ratio_spread(self._cpu("dirty1 update"), update),
            "moved_over_full": ratio_spread(self._cpu("object moved"), update),
        }
        return {name: ratio.as_dict() for name, ratio in ratios.items()}

    @staticmethod
    def _row(medians: dict[str, dict[str, float]], fast: str, plain: str) -> dict[str, float | None]:
        own = medians.get(fast)
        if own is None:
            return {}
        numpy_cpu = medians[plain]["cpu_ms"] if plain in medians else None
        return {
            **own,
            "copies": own["cpu_ms"] / medians["copy"]["cpu_ms"],
            "numpy_cpu_ms": numpy_cpu,
            "times_faster_than_numpy": None
            if numpy_cpu is None
            else numpy_cpu / max(own["cpu_ms"], _TINY_MS),
        }

    def _scene(self) -> dict[str, Any]:
        scenario = self._scenario
        return {
            "name": scenario.name,
            "atlas": [scenario.texels.width, scenario.texels.height],
            "texels": int(scenario.texels.area.shape[0]),
            "pairs": int(scenario.table.pixel.shape[0]),
            "cameras": [list(shape) for shape in scenario.table.camera_shapes],
            "objects": len(scenario.objects),
            "vals": self._settings.num_vals,
            "split_ratio": self._settings.split_ratio,
        }


def _machine() -> dict[str, Any]:
    return {
        "cpus": len(os.sched_getaffinity(0)),
        "processor": platform.machine(),
        "python": platform.python_version(),
        "numpy": np.__version__,
    }


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


def _with_revision(frames: Sequence[CameraFrame], revision: int) -> tuple[CameraFrame, ...]:
    return tuple(replace(frame, content_revision=revision, sequence=revision) for frame in frames)

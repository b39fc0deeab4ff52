"""What a whole light update costs against the size of everything: box rooms in closed form, all pictures new."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any, Final

from nearfield_server.benchmark.ratios import fit_exponent
from nearfield_server.benchmark.scenario import Scenario, box_scenario, noisy_frames
from nearfield_server.pipeline.runner import BackendName, LightPipeline
from nearfield_server.records import LightSettings

_VALS: Final = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Form:
    """A box room and its settings; see `box_scenario`."""

    atlas_size: int
    camera_size: int
    cameras: int = 4
    objects: int = 3
    vals: int = _VALS

    def scenario(self) -> Scenario:
        """Build the room and its pictures."""
        return box_scenario(
            self.atlas_size,
            camera_size=self.camera_size,
            num_cameras=self.cameras,
            num_objects=self.objects,
        )


def measure_server_growth(
    backend: BackendName, quick: bool, progress: Callable[[str], None], *, tiny: bool = False
) -> dict[str, Any]:
    """CPU time of one update, all threads.

    Args:
        backend: of the pipeline.
        quick: smaller rooms and fewer rounds.
        progress: called with a line of text before each step.
        tiny: proves that everything runs; the figures say nothing.

    Returns:
        Per name (`atlas_texels`, `camera_pixels`, `cameras`, `server_vals`, `server_objects`): `x`, `cpu_ms` and the fitted `exponent`.
    """
    size, rounds = (48, 1) if tiny else (256, 4) if quick else (512, 10)
    settings = LightSettings(num_samples=64) if tiny else LightSettings()
    return {
        name: _measure_direction(name, forms, settings, backend, rounds, progress)
        for name, forms in growth_forms(size).items()
    }


def growth_forms(size: int) -> dict[str, tuple[Form, ...]]:
    """Rooms in which one thing grows about a room with atlas and pictures of `size`^2."""
    base = Form(atlas_size=size, camera_size=size)
    return {
        "atlas_texels": tuple(replace(base, atlas_size=edge) for edge in (size // 2, size, 2 * size)),
        "camera_pixels": tuple(replace(base, camera_size=edge) for edge in (size // 2, size, 2 * size)),
        "cameras": tuple(replace(base, cameras=number) for number in (1, 2, 4)),
        "server_vals": tuple(replace(base, vals=number) for number in (8, 16, 32, 64)),
        "server_objects": tuple(replace(base, objects=number) for number in (1, 2, 4, 8)),
    }


def _size_of(name: str, form: Form, scenario: Scenario) -> int:
    sizes: Mapping[str, int] = {
        "atlas_texels": int(scenario.texels.area.shape[0]),
        "camera_pixels": sum(height * width for height, width in scenario.table.camera_shapes),
        "cameras": form.cameras,
        "server_vals": form.vals,
        "server_objects": form.objects,
    }
    return sizes[name]


def _measure_direction(
    name: str,
    forms: Sequence[Form],
    settings: LightSettings,
    backend: BackendName,
    rounds: int,
    progress: Callable[[str], None],
) -> dict[str, Any]:
    """All sizes of one thing, in turn within every round."""
    progress(f"growth, {name}: building {len(forms)} rooms")
    scenarios = [form.scenario() for form in forms]
    updates = [
        _Updates(scenario, replace(settings, num_vals=form.vals), backend)
        for scenario, form in zip(scenarios, forms, strict=True)
    ]
    # The first update allocates, the second compiles what only a warm start needs.
    for warm in updates * 2:
        warm.cpu_ms()
    costs: list[list[float]] = [[] for _ in forms]
    for number in range(rounds):
        progress(f"growth, {name}: round {number + 1} of {rounds}")
        for values, each in zip(costs, updates, strict=True):
            values.append(each.cpu_ms())
    sizes = [_size_of(name, form, scenario) for form, scenario in zip(forms, scenarios, strict=True)]
    medians = [median(values) for values in costs]
    return {"x": sizes, "cpu_ms": medians, "exponent": fit_exponent(sizes, medians)}


class _Updates:
    """Times updates of one room; every picture is new each time."""

    def __init__(self, scenario: Scenario, settings: LightSettings, backend: BackendName) -> None:
        self._pipeline = LightPipeline(
            scenario.mesh,
            scenario.texels,
            scenario.table,
            settings,
            probe_rays=scenario.probes,
            backend=backend,
        )
        self._objects = scenario.objects
        self._pictures = [noisy_frames(scenario, seed) for seed in range(2)]
        self._revision = 0

    def cpu_ms(self) -> float:
        self._revision += 1
        frames = [
            replace(frame, content_revision=self._revision, sequence=self._revision)
            for frame in self._pictures[self._revision % 2]
        ]
        before = time.process_time()
        self._pipeline.update(frames, self._objects)
        return 1e3 * (time.process_time() - before)

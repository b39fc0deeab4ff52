"""`nearfield bench`: what every stage of the light pipeline costs, next to plain numpy and to memory bandwidth.

All figures of a run come from interleaved rounds of the same process, so that their ratios hold on a busy machine too.
CPU time is that of all threads.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Annotated, Any, Final

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from nearfield_server.errors import AssetError
from nearfield_server.pipeline.hidden_light import HiddenLight
from nearfield_server.pipeline.probes import ProbeTracer
from nearfield_server.pipeline.runner import STAGES, BackendName, LightPipeline
from nearfield_server.records import (
    CameraFrame,
    GatherTable,
    LightSettings,
    LightUpdate,
    ObjectPose,
    RoomMesh,
    TexelGeometry,
    UnseenFill,
)
from nearfield_server.reference.box_room import lamp_field, make_box_room

_COPY_BYTES: Final = 1 << 25
"""np.copyto of 32 MiB reads and writes 67 MB: the yardstick of memory bandwidth."""
_NUM_OBJECTS: Final = 3
_NOISE: Final = 0.01
_PARTS: Final = ("wall_ms", "cpu_ms")
_UNCHANGED_CALLS: Final = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """What is measured: a room, its probes and pictures of all its cameras."""

    name: str
    mesh: RoomMesh
    texels: TexelGeometry
    table: GatherTable
    probes: ProbeTracer
    pictures: tuple[NDArray[np.float16], ...]
    objects: tuple[ObjectPose, ...]
    unseen_fill: UnseenFill | None = None
    hidden_light: HiddenLight | None = None


def bench(
    out: Annotated[Path, typer.Option("--out", help="Folder for bench.json.")],
    room: Annotated[
        Path | None, typer.Option(help="Evaluation bundle; default: a box room in closed form.")
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Interleaved rounds.")] = 15,
    backend: Annotated[str, typer.Option(help="auto, cpu or gl.")] = "auto",
    vals: Annotated[int, typer.Option(min=1, max=64, help="Slots for virtual area lights.")] = 16,
    ratio: Annotated[
        float | None, typer.Option(help="Fixed share of direct light; default: from the atlas.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small atlas and pictures, few rounds.")] = False,
) -> None:
    """Measure the light pipeline and write bench.json."""
    if backend not in ("auto", "cpu", "gl"):
        raise typer.BadParameter(f"expected auto, cpu or gl, found {backend!r}", param_hint="--backend")
    size = 256 if quick else 1024
    console = Console()
    scenario = _box_scenario(size) if room is None else _bundle_scenario(room)
    settings = LightSettings(num_vals=vals, split_ratio=ratio)
    name: BackendName = "cpu" if backend == "cpu" else "gl" if backend == "gl" else "auto"
    report = measure(scenario, settings, name, min(rounds, 5) if quick else rounds)
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "bench.json").write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise AssetError(f"{out}: cannot write bench.json: {error.strerror}; choose another --out") from error
    console.print(_table(report))
    console.print(f"{out / 'bench.json'}", highlight=False)


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
    frames = [_noisy_frames(scenario, seed) for seed in range(2)]
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


def _table(report: dict[str, Any]) -> Table:
    scene = report["scene"]
    title = f"{scene['name']}: {scene['texels']} texels, {scene['pairs']} pairs, {report['backend']}"
    table = Table(title=title)
    for heading in ("stage", "wall ms", "CPU ms", "x copy of 67 MB", "numpy CPU ms", "x faster"):
        table.add_column(heading, justify="left" if heading == "stage" else "right")
    rows = [
        *report["stages"].items(),
        ("whole update", report["update"]),
        ("object moved", report["object_moved"]),
    ]
    for name, row in rows:
        if row:
            values = (
                row[k] for k in ("wall_ms", "cpu_ms", "copies", "numpy_cpu_ms", "times_faster_than_numpy")
            )
            table.add_row(name, *("-" if value is None else f"{value:.2f}" for value in values))
    copy = report["copy_67_mb"]
    table.add_row("copy of 67 MB", f"{copy['wall_ms']:.2f}", f"{copy['cpu_ms']:.2f}", "1.00", "-", "-")
    table.add_row("unchanged update", f"{report['unchanged_us'] * 1e-3:.5f}", "-", "-", "-", "-")
    return table


def _noisy_frames(scenario: Scenario, seed: int) -> tuple[CameraFrame, ...]:
    """The pictures with one per cent of noise, so that every stage has real work."""
    rng = np.random.default_rng(seed)
    frames = []
    for index, picture in enumerate(scenario.pictures):
        pixels = picture.copy()
        gain = rng.normal(1.0, _NOISE, (*pixels.shape[:2], 1)).astype(np.float32)
        pixels[..., :3] = np.clip(pixels[..., :3].astype(np.float32) * gain, 0.0, 65504.0)
        frames.append(
            CameraFrame(camera_index=index, sequence=0, content_revision=0, timestamp_ns=0, pixels=pixels)
        )
    return tuple(frames)


def _with_revision(frames: Sequence[CameraFrame], revision: int) -> tuple[CameraFrame, ...]:
    return tuple(replace(frame, content_revision=revision, sequence=revision) for frame in frames)


def _objects(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[ObjectPose, ...]:
    """Three objects along the diagonal of the room's box, a third of its height above the floor."""
    objects = []
    for index in range(_NUM_OBJECTS):
        world_from_object = np.eye(4)
        world_from_object[:3, 3] = low + (high - low) * [0.3 + 0.2 * index, 0.33, 0.3 + 0.2 * index]
        objects.append(
            ObjectPose(
                object_index=index,
                revision=1,
                world_from_object=world_from_object,
                centre_object=np.zeros(3),
                radius=0.15,
            )
        )
    return tuple(objects)


def _box_scenario(size: int) -> Scenario:
    room = make_box_room(atlas_size=size, camera_size=size)
    lamp = (3, (0.5, 0.5), (0.1, 0.1), (40.0, 38.0, 30.0))
    window = (0, (0.5, 0.6), (0.1, 0.2), (10.0, 12.0, 15.0))
    field = lamp_field(room, (lamp, window))
    return Scenario(
        name="box room",
        mesh=room.mesh(),
        texels=room.texels,
        table=room.table,
        probes=room,
        pictures=tuple(room.picture(index, field) for index in range(len(room.cameras))),
        objects=_objects(np.zeros(3), room.size),
    )


def _bundle_scenario(folder: Path) -> Scenario:
    # Geometry and evaluation bring ray tracing and image libraries; the box room does without.
    from nearfield_server.evaluation.light_run import camera_frames
    from nearfield_server.geometry.cache import load_or_build
    from nearfield_server.geometry.probes import ProbeRays
    from nearfield_server.scene.bundle import load_bundle
    from nearfield_server.scene.room_config import room_from_bundle

    bundle = load_bundle(folder)
    room = room_from_bundle(bundle)
    mesh, texels, table, fill, hidden = load_or_build(room)
    frames, _ = camera_frames(bundle, np.ones(len(room.lights)))
    return Scenario(
        name=room.name,
        mesh=mesh,
        texels=texels,
        table=table,
        probes=ProbeRays(mesh, texels),
        pictures=tuple(frame.pixels for frame in frames),
        objects=_objects(mesh.positions.min(axis=0), mesh.positions.max(axis=0)),
        unseen_fill=fill,
        hidden_light=hidden,
    )

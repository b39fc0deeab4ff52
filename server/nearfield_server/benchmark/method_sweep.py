"""Error against time and bytes: every method with every number of lights, judged by path-traced truth.

First all light is extracted (CPU time of one update, everything on the server), then the real client draws it. Rows are kept as they are
finished, so that an interrupted run can go on.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from nearfield_server.benchmark.assembly_files import write_json
from nearfield_server.benchmark.flicker import flicker, val_movement_mm
from nearfield_server.benchmark.method_judgement import irradiance_at_points, mean_of_views
from nearfield_server.benchmark.method_packets import MAX_LIGHTS, MethodPackets
from nearfield_server.benchmark.method_scene import MethodScene, load_method_scene
from nearfield_server.benchmark.method_views import MethodViews, open_views
from nearfield_server.benchmark.methods import METHODS, MethodEntry
from nearfield_server.benchmark.methods.light import Transfer
from nearfield_server.benchmark.parts import BenchSetup
from nearfield_server.benchmark.transfer_forms import reduced_model, room_with_models
from nearfield_server.errors import AssetError
from nearfield_server.evaluation.irradiance import PlacedObject, rel_rmse
from nearfield_server.evaluation.view_truth import judge_view
from nearfield_server.radiometry.image_metrics import display

PICTURES: Final = "methods"
"""Folder of the run with the first view as every method shows it, and as it is."""
TRANSFERS: Final[tuple[Transfer, ...]] = ("full", "shadowed", "cosine")


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPlan:
    """How much is measured.

    Attributes:
        light_counts: of those that a method has, which are measured; methods without a choice take part always.
        num_noisy: pictures of the noisy sequence.
        max_views: views that are judged.
        num_frames: frames that are timed; with more than 64 lights one, which takes many turns already.
    """

    light_counts: tuple[int, ...]
    num_noisy: int
    max_views: int
    num_frames: int

    def counts_of(self, entry: MethodEntry) -> tuple[int, ...]:
        """Light counts of one method."""
        if len(entry.light_counts) == 1:
            return entry.light_counts
        return tuple(count for count in entry.light_counts if count in self.light_counts)

    def frames_of(self, lights: int) -> int:
        """Frames that are timed with a number of lights."""
        return self.num_frames if lights <= MAX_LIGHTS else 1


FULL: Final = SweepPlan(light_counts=(8, 16, 32, 64, 128, 256, 512), num_noisy=9, max_views=8, num_frames=3)
QUICK: Final = SweepPlan(light_counts=(16,), num_noisy=4, max_views=3, num_frames=2)
TINY: Final = SweepPlan(light_counts=(8, 128), num_noisy=2, max_views=1, num_frames=1)


def plan_of(setup: BenchSetup) -> SweepPlan:
    """What a run measures."""
    return TINY if setup.tiny else QUICK if setup.quick else FULL


def methods_section(setup: BenchSetup) -> list[dict[str, Any]]:
    """One row per bundle, method and number of lights.

    Raises:
        AssetError: a bundle is broken.
        ServiceError: the client is not built, there is no browser, or the page fails.
    """
    plan = plan_of(setup)
    rows = _KeptRows(setup.out / "methods.json", plan, setup.backend, setup.resume)
    for path in setup.bundles:
        setup.say(f"  bundle {path.name}")
        scene = load_method_scene(
            path,
            num_noisy=plan.num_noisy,
            max_views=plan.max_views,
            backend=setup.backend,
            say=setup.say,
        )
        _keep_picture(
            rows.pictures / f"{scene.bundle.name}_truth.jpg", scene.views[0][1].truth, scene.exposure
        )
        for transfer in TRANSFERS:
            wanted = [
                (name, lights)
                for name, entry in METHODS.items()
                if entry.form.transfer == transfer
                for lights in plan.counts_of(entry)
                if not rows.has(scene.bundle.name, name, lights)
            ]
            if wanted:
                _measure_transfer(scene, transfer, wanted, plan, rows, setup.say)
    return rows.rows


class _KeptRows:
    """Rows, and the file that holds them from row to row."""

    def __init__(self, path: Path, plan: SweepPlan, backend: str, resume: bool) -> None:
        self._path = path
        self._settings = {**asdict(plan), "light_counts": list(plan.light_counts), "backend": backend}
        self.pictures = path.parent / PICTURES
        self.rows: list[dict[str, Any]] = []
        if resume and path.is_file():
            former = json.loads(path.read_text(encoding="utf-8"))
            if former["settings"] == self._settings:
                self.rows = former["rows"]

    def has(self, bundle: str, name: str, lights: int) -> bool:
        return any((row["bundle"], row["name"], row["lights"]) == (bundle, name, lights) for row in self.rows)

    def add(self, row: dict[str, Any]) -> None:
        self.rows.append(row)
        write_json(self._path, {"settings": self._settings, "rows": self.rows})


def _measure_transfer(
    scene: MethodScene,
    transfer: Transfer,
    wanted: Sequence[tuple[str, int]],
    plan: SweepPlan,
    rows: _KeptRows,
    say: Callable[[str], None],
) -> None:
    """All methods whose objects have the same form of transfer: they share a page."""
    objects = tuple(
        PlacedObject(
            model=reduced_model(item.model, transfer),
            albedo=item.albedo,
            world_from_object=item.world_from_object,
        )
        for item in scene.objects
    )
    with tempfile.TemporaryDirectory() as folder:
        room = room_with_models(scene.room, transfer, Path(folder))
        with open_views(room, scene.mesh, len(scene.texels.texel_index), say) as views:
            for name, lights in wanted:
                started = time.monotonic()
                row = _measure(scene, name, lights, objects, views, plan, rows.pictures)
                rows.add(row)
                say(f"  {name} {lights}: {time.monotonic() - started:.0f} s")


def _measure(
    scene: MethodScene,
    name: str,
    lights: int,
    objects: tuple[PlacedObject, ...],
    views: MethodViews,
    plan: SweepPlan,
    pictures: Path,
) -> dict[str, Any]:
    """One row; the first view's picture is kept beside it."""
    entry = METHODS[name]
    method = entry.make(scene.around, lights, scene.make_nearfield)
    moments, times = [], []
    for sample in (scene.clean, *scene.noisy):
        started = time.process_time()
        moments.append(method.extract(sample))
        times.append(1e3 * (time.process_time() - started))
    gather_ms = 0.0 if entry.gathers else scene.gather_cpu_ms
    views.use(entry.form)
    clean, noisy = moments[0], moments[1:]
    composites = [views.composite(index, clean, full_quality=True) for index, _ in scene.views]
    judged = [
        judge_view(truth, composite, scene.exposure)
        for (_, truth), composite in zip(scene.views, composites, strict=True)
    ]
    at_points = irradiance_at_points(scene, clean, objects, room_shadows=entry.form.room_shadows)
    first_view = scene.views[0][0]
    _keep_picture(pictures / f"{scene.bundle.name}_{name}_{lights}.jpg", composites[0], scene.exposure)
    stills = [views.composite(first_view, moment, full_quality=False) for moment in noisy]
    frames = [noisy[number % len(noisy)] for number in range(plan.frames_of(lights))]
    return {
        "bundle": scene.bundle.name,
        "name": name,
        "lights": lights,
        "irradiance_rel_rmse": None if at_points is None else rel_rmse(*at_points),
        "shadow_rel_rmse": mean_of_views(judged, "shadow_rel_rmse"),
        "object_rel_rmse": mean_of_views(judged, "object_rel_rmse"),
        "flip": mean_of_views(judged, "flip_mean"),
        "flicker": flicker(stills, scene.exposure),
        "val_movement_mm": val_movement_mm([moment.vals for moment in noisy]),
        # The first two updates compile, and fill what only a warm start has.
        "server_ms": gather_ms + float(np.median(times[2:] or times)),
        "client_ms": views.frame_cpu_ms(first_view, frames),
        "bytes": MethodPackets(scene.mesh).num_bytes(clean),
        "views": len(judged),
    }


def _keep_picture(path: Path, picture: NDArray[np.float64], exposure: float) -> None:
    shown = np.rint(255.0 * display(picture, exposure)).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), shown[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88]):
        raise AssetError(f"{path}: cannot be written; choose another --out")

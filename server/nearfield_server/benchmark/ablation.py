"""What each ingredient brings: Nearfield as it is, and with one ingredient after the other left out.

Every row holds the errors, the bytes of an update and its processor time without that ingredient. Ingredients of the light and of
the models are judged at the bundle's points, those of the renderer on its tablet views.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from nearfield_server.benchmark.method_judgement import irradiance_at_points, mean_of_views
from nearfield_server.benchmark.method_packets import MethodPackets
from nearfield_server.benchmark.method_scene import MethodScene, load_method_scene
from nearfield_server.benchmark.method_views import MethodViews, open_views
from nearfield_server.benchmark.methods.light import ClientForm, MethodLight
from nearfield_server.evaluation.irradiance import PlacedObject, bias, rel_rmse
from nearfield_server.evaluation.view_truth import judge_view
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.records import LightSettings

NUM_VALS: Final = 16
LEAST_PAPER_RATIO: Final = 0.75
"""Lower end of the share of direct light that Rohmer et al. 2014, section 4.2, use; the baselines take the middle of it."""
WHOLE: Final = ClientForm(transfer="full", indirect_exchange=True, fixture_rays=True)
_TIMED_UPDATES: Final = 5

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ingredient:
    """One thing that can be left out.

    Attributes:
        name: of the row.
        split_ratio: fixed share of direct light without it; None chooses the threshold from the atlas.
        hidden: keep lamps that no camera sees. fill: keep what stands in for unseen surfaces.
        of_light: turns the extracted light into that without it.
        of_object: turns an object into one without it.
        form: of the renderer without it.
    """

    name: str
    split_ratio: float | None = None
    hidden: bool = True
    fill: bool = True
    of_light: Callable[[MethodLight], MethodLight] = lambda light: light
    of_object: Callable[[PlacedObject], PlacedObject] = lambda item: item
    form: ClientForm = WHOLE

    @property
    def changes_models(self) -> bool:
        """Whether the objects are others, so that the page would have to be loaded again."""
        return self.of_object is not NOTHING.of_object


def _points_instead_of_discs(light: MethodLight) -> MethodLight:
    vals = light.vals.copy()
    vals["area"] = 0.0
    return replace(light, vals=vals)


def _no_indirect(light: MethodLight) -> MethodLight:
    return replace(light, object_sh=np.zeros_like(light.object_sh))


def _no_interreflection(item: PlacedObject) -> PlacedObject:
    transfer = item.model.transfer
    none = np.zeros_like(transfer.bounce1)
    bare = replace(transfer, bounce1=none, bounce2=none, bounce_ratio=0.0)
    return replace(item, model=replace(item.model, transfer=bare))


def _no_ground_shadow(item: PlacedObject) -> PlacedObject:
    return replace(item, model=replace(item.model, ground_shadow=np.zeros_like(item.model.ground_shadow)))


NOTHING: Final = Ingredient(name="nothing left out")
INGREDIENTS: Final = (
    NOTHING,
    Ingredient(name="split in a gap of the histogram", split_ratio=LEAST_PAPER_RATIO),
    Ingredient(name="lights as discs", of_light=_points_instead_of_discs),
    Ingredient(name="indirect light", of_light=_no_indirect),
    Ingredient(name="lamps that no camera sees", hidden=False),
    Ingredient(name="unseen surfaces filled", fill=False),
    Ingredient(name="self-interreflection", of_object=_no_interreflection),
    Ingredient(name="ground shadow", of_object=_no_ground_shadow),
    Ingredient(name="indirect exchange", form=replace(WHOLE, indirect_exchange=False)),
    Ingredient(name="fixture rays", form=replace(WHOLE, fixture_rays=False)),
)


def measure_ablation(
    bundle: str | Path, quick: bool, progress: Progress, *, with_views: bool = True
) -> list[dict[str, Any]]:
    """Measure one bundle at nominal light.

    Args:
        bundle: folder of an evaluation bundle.
        quick: judge one view instead of all.
        progress: told what is being done.
        with_views: draw the tablet views with the real client.

    Returns:
        One row per ingredient, the whole first: `bundle`, `without`, `irradiance_rel_rmse` and `irradiance_bias` (None where the
        bundle has no points), `shadow_rel_rmse` and `object_rel_rmse` (None where not drawn: the ingredient lies in the models,
        or there are no views), `bytes`, `server_cpu_ms`.

    Raises:
        AssetError: the bundle is broken or holds no view with truth.
        ServiceError: the client is not built, there is no browser, or the page fails.
    """
    scene = load_method_scene(
        Path(bundle), num_noisy=0, max_views=1 if quick else 8, backend="auto", say=progress
    )
    rows: list[dict[str, Any]] = []
    lights: list[MethodLight] = []
    packets = MethodPackets(scene.mesh)
    for ingredient in INGREDIENTS:
        progress(f"  without {ingredient.name}")
        light, cpu_ms = _extract(scene, ingredient)
        lights.append(light)
        row: dict[str, Any] = {"bundle": scene.bundle.name, "without": ingredient.name}
        row |= _irradiance_errors(scene, ingredient, light)
        row |= {"shadow_rel_rmse": None, "object_rel_rmse": None}
        rows.append(row | {"bytes": packets.num_bytes(light), "server_cpu_ms": cpu_ms})
    if with_views:
        with open_views(scene.room, scene.mesh, len(scene.texels.texel_index), progress) as views:
            for ingredient, light, row in zip(INGREDIENTS, lights, rows, strict=True):
                if not ingredient.changes_models:
                    progress(f"  pictures without {ingredient.name}")
                    row |= _picture_errors(scene, ingredient, light, views)
    return rows


def _extract(scene: MethodScene, ingredient: Ingredient) -> tuple[MethodLight, float]:
    """The light, and the median CPU milliseconds of an update with new pictures."""
    pipeline = LightPipeline(
        scene.mesh,
        scene.texels,
        scene.table,
        LightSettings(num_vals=NUM_VALS, split_ratio=ingredient.split_ratio),
        probe_rays=scene.probe_rays,
        backend=scene.backend,
        unseen_fill=scene.fill if ingredient.fill else None,
        hidden_light=scene.hidden if ingredient.hidden else None,
    )
    times = []
    for number in range(_TIMED_UPDATES + 1):
        frames = [replace(frame, content_revision=number) for frame in scene.clean.frames]
        update = pipeline.update(frames, scene.poses)
        times.append(sum(stage.cpu_ms for stage in update.stages))
    light = MethodLight(vals=update.vals, object_sh=update.object_sh)
    # The first update traces the probes, and may compile.
    return ingredient.of_light(light), float(np.median(times[1:]))


def _irradiance_errors(scene: MethodScene, ingredient: Ingredient, light: MethodLight) -> dict[str, Any]:
    found = irradiance_at_points(scene, light, tuple(ingredient.of_object(item) for item in scene.objects))
    if found is None:
        return {"irradiance_rel_rmse": None, "irradiance_bias": None}
    return {"irradiance_rel_rmse": rel_rmse(*found), "irradiance_bias": bias(*found)}


def _picture_errors(
    scene: MethodScene, ingredient: Ingredient, light: MethodLight, views: MethodViews
) -> dict[str, Any]:
    """Means over the judged views."""
    views.use(ingredient.form)
    judged = [
        judge_view(truth, views.composite(index, light, full_quality=True), scene.exposure)
        for index, truth in scene.views
    ]
    return {key: mean_of_views(judged, key) for key in ("shadow_rel_rmse", "object_rel_rmse")}

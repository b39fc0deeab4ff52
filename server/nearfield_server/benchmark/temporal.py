"""How steady the light is in time: camera noise, switched lamps, and lamps that are slowly dimmed.

Measured on the light itself (VALs, and the unoccluded irradiance that they and the SH make on small objects), so that it needs no
renderer: a picture cannot flicker or pop by more than the irradiance behind it does. Clients cross-fade on top of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from nearfield_server.benchmark.scenario import Scenario, noisy_frames
from nearfield_server.pipeline.runner import LightPipeline
from nearfield_server.radiometry.form_factor import val_irradiance
from nearfield_server.radiometry.sh import irradiance
from nearfield_server.records import CameraFrame, LightSettings, LightUpdate

RIGHT_LIGHT: Final = 0.02
"""Deviation of the irradiance (RMS over faces and channels, relative to its mean) up to which light counts as right."""
_NORMALS: Final = np.concatenate([np.eye(3), -np.eye(3)])
_SETTLED: Final = 3
"""Updates after which a pipeline on unchanged pictures counts as converged."""
_FOLLOWED: Final = 4
"""Updates that are watched after a switch."""
_QUICK_LAMPS: Final = 2

Pictures = Sequence[NDArray[np.float16]]


def measure_temporal(
    scenario: Scenario, quick: bool, settings: LightSettings | None = None
) -> dict[str, Any]:
    """Measure one room.

    Args:
        scenario: room and pictures; lamps are switched where it tells how the room looks without them.
        quick: fewer updates, two lamps at most.
        settings: of the light extraction; None = the default.

    Returns:
        `noise` of `measure_noise`, `lamps` with one entry of `measure_lamp` each, and their worst figures: val_movement_mm,
        generation_changes, irradiance_flicker, updates_to_right_light, irradiance_step.
    """
    make = _maker(scenario, settings if settings is not None else LightSettings())
    noise = measure_noise(scenario, make, 30 if quick else 120)
    count = min(scenario.num_lamps, _QUICK_LAMPS) if quick else scenario.num_lamps
    lamps = [measure_lamp(scenario, make, lamp, 16 if quick else 48) for lamp in range(count)]
    return {
        "scene": scenario.name,
        **{key: noise[key] for key in ("val_movement_mm", "generation_changes", "irradiance_flicker")},
        "updates_to_right_light": max((entry["updates_to_right_light"] for entry in lamps), default=None),
        "irradiance_step": max((entry["irradiance_step"] for entry in lamps), default=None),
        "noise": noise,
        "lamps": lamps,
    }


def measure_noise(scenario: Scenario, make: Callable[[], LightPipeline], updates: int) -> dict[str, Any]:
    """A static room under cameras with one per cent of noise per pixel.

    Returns:
        val_movement_mm: largest extent of the places that one VAL takes over all updates (not only between two of them).
        vals_that_come_and_go: VALs that are dark in some updates. generation_changes: slots given to another light.
        irradiance_flicker: largest change of a face's irradiance between two updates, relative to the mean of its object.
    """
    pipeline = make()
    moments, light = [], []
    for number in range(updates + 1):
        pixels = [frame.pixels for frame in noisy_frames(scenario, number)]
        update = pipeline.update(_frames(pixels, number), scenario.objects)
        if number > 0:  # the very first update has nothing to be steady against
            moments.append(update.vals.copy())
            light.append(object_irradiance(scenario, update))
    vals, values = np.stack(moments), np.stack(light)
    lit = vals["radiant_intensity"].any(axis=2)
    always = lit.all(axis=0)
    extent = np.ptp(vals["position"][:, always].astype(np.float64), axis=0)
    relative = values / np.maximum(values.mean(axis=(0, 2), keepdims=True), 1e-30)
    return {
        "updates": updates,
        "val_movement_mm": float(1e3 * np.linalg.norm(extent, axis=1).max(initial=0.0)),
        "vals_that_come_and_go": int(np.count_nonzero(lit.any(axis=0) & ~always)),
        "generation_changes": _changes(moments),
        "irradiance_flicker": float(np.abs(np.diff(relative, axis=0)).max(initial=0.0)),
    }


def measure_lamp(
    scenario: Scenario, make: Callable[[], LightPipeline], lamp: int, steps: int
) -> dict[str, Any]:
    """Switch one lamp off and on, then dim it to nothing and back, while all others shine.

    Returns:
        lamp, turned_off and turned_on: deviation from a pipeline that starts afresh on the same pictures, after 1, 2, ... updates;
        updates_to_right_light: after which it stays below `RIGHT_LIGHT` (or just beyond those watched);
        irradiance_step: of all dimming steps, the largest deviation of a face's irradiance from an even change, relative to
        the mean of its object at full light (light is linear, so that equal steps of the lamp should change it by as much);
        even_step: the largest even change, to compare with; generation_changes while dimming.
    """
    if scenario.without_lamp is None:
        raise ValueError(f"{scenario.name}: there are no pictures without a lamp")
    full, dark = scenario.pictures, scenario.without_lamp(lamp)
    turned_off, turned_on = _switch(scenario, make, full, dark), _switch(scenario, make, dark, full)
    late = [
        index + 1 for error in (turned_off, turned_on) for index, e in enumerate(error) if e > RIGHT_LIGHT
    ]
    moments, light = _dim(scenario, make(), full, dark, steps)
    scale = np.maximum(light[0].mean(axis=1), 1e-30)[:, None]
    halves = [np.diff(half, axis=0) / scale for half in (light[: steps + 1], light[steps:])]
    return {
        "lamp": lamp,
        "turned_off": turned_off,
        "turned_on": turned_on,
        "updates_to_right_light": 1 + max(late, default=0),
        "irradiance_step": max(float(np.abs(half - half.mean(axis=0)).max()) for half in halves),
        "even_step": max(float(np.abs(half.mean(axis=0)).max()) for half in halves),
        "generation_changes": _changes(moments),
    }


def object_irradiance(scenario: Scenario, update: LightUpdate) -> NDArray[np.float64]:
    """(objects, 6, 3) irradiance on faces along the axes at the centre of every object, unoccluded, W/m^2."""
    result = np.zeros((len(scenario.objects), len(_NORMALS), 3))
    for index, pose in enumerate(scenario.objects):
        centre = pose.world_from_object[:3, :3] @ pose.centre_object + pose.world_from_object[:3, 3]
        points = np.broadcast_to(centre, _NORMALS.shape)
        result[index] = irradiance(update.object_sh[index], _NORMALS)
        for val in update.vals[update.vals["radiant_intensity"].any(axis=1)]:
            place, intensity, area = (val["position"], val["normal"]), val["radiant_intensity"], val["area"]
            result[index] += val_irradiance(points, _NORMALS, *place, intensity, float(area))
    return result


def _switch(
    scenario: Scenario, make: Callable[[], LightPipeline], before: Pictures, after: Pictures
) -> list[float]:
    """Deviation from the right light after 1, 2, ... updates with the new pictures."""
    pipeline, fresh = make(), make()
    for number in range(_SETTLED):
        pipeline.update(_frames(before, number), scenario.objects)
        wanted = fresh.update(_frames(after, number), scenario.objects)
    truth = object_irradiance(scenario, wanted)
    errors = []
    for number in range(_SETTLED, _SETTLED + _FOLLOWED):
        found = object_irradiance(scenario, pipeline.update(_frames(after, number), scenario.objects))
        deviation = np.sqrt(np.mean((found - truth) ** 2, axis=(1, 2)))
        errors.append(float((deviation / np.maximum(truth.mean(axis=(1, 2)), 1e-30)).max(initial=0.0)))
    return errors


def _dim(
    scenario: Scenario, pipeline: LightPipeline, full: Pictures, dark: Pictures, steps: int
) -> tuple[list[NDArray[np.void]], NDArray[np.float64]]:
    """VALs and (2 steps + 1, objects, 6, 3) irradiance while the lamp goes off and on again."""
    down = np.linspace(1.0, 0.0, steps + 1)
    moments, light = [], []
    for number, weight in enumerate(np.concatenate([down, down[-2::-1]]).astype(np.float32)):
        mixed = [
            (weight * a.astype(np.float32) + (1 - weight) * b.astype(np.float32)).astype(np.float16)
            for a, b in zip(full, dark, strict=True)
        ]
        update = pipeline.update(_frames(mixed, number), scenario.objects)
        moments.append(update.vals.copy())
        light.append(object_irradiance(scenario, update))
    return moments, np.stack(light)


def _changes(moments: Sequence[NDArray[np.void]]) -> int:
    generations = np.stack([vals["generation"] for vals in moments])
    return int(np.count_nonzero(generations[1:] != generations[:-1]))


def _frames(pictures: Pictures, number: int) -> tuple[CameraFrame, ...]:
    return tuple(
        CameraFrame(
            camera_index=index, sequence=number, content_revision=number, timestamp_ns=number, pixels=pixels
        )
        for index, pixels in enumerate(pictures)
    )


def _maker(scenario: Scenario, settings: LightSettings) -> Callable[[], LightPipeline]:
    def make() -> LightPipeline:
        return LightPipeline(
            scenario.mesh,
            scenario.texels,
            scenario.table,
            settings,
            probe_rays=scenario.probes,
            unseen_fill=scenario.unseen_fill,
            hidden_light=scenario.hidden_light,
        )

    return make

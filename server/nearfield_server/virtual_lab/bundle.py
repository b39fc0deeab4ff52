"""Renders a scene and writes it as an evaluation bundle (see README.md of this package for the format)."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nearfield_server.virtual_lab.backend import Backend
from nearfield_server.virtual_lab.description import describe_scene
from nearfield_server.virtual_lab.geometry import Cells, build_cells, build_geometry
from nearfield_server.virtual_lab.glb import pack_room, write_object_glb, write_room_glb
from nearfield_server.virtual_lab.model import Scene
from nearfield_server.virtual_lab.noise import camera_noise, point_noise, view_noise
from nearfield_server.virtual_lab.pictures import (
    Codec,
    box_half,
    codec_error,
    round_mantissa,
    write_exr,
    write_mask,
    write_preview,
)
from nearfield_server.virtual_lab.radiosity import RadiosityCache, solve_radiosity
from nearfield_server.virtual_lab.render import (
    RenderedImage,
    pixels_in_circle,
    point_irradiance,
    render_image,
)
from nearfield_server.virtual_lab.tracer import Tracer

SEED_CACHE, SEED_VIEWS, SEED_CAMERAS, SEED_POINTS = 11, 100, 200, 300
NUM_POINTS = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """How much work goes into a bundle; all counts are powers of two.

    Attributes:
        cell_points: sample points per radiosity cell. cell_rays: gather rays from each.
        view_samples: per tablet pixel. view_rays: gather rays per sample.
        camera_samples: per fish-eye pixel. camera_rays: gather rays per sample.
        point_replicas, point_samples, point_rays: lanes per point and half, samples per lane, gather rays per sample.
    """

    cell_points: int
    cell_rays: int
    view_samples: int
    view_rays: int
    camera_samples: int
    camera_rays: int
    point_replicas: int
    point_samples: int
    point_rays: int = 4


QUALITIES = {
    "preview": Quality(
        cell_points=8,
        cell_rays=4,
        view_samples=4,
        view_rays=4,
        camera_samples=4,
        camera_rays=2,
        point_replicas=16,
        point_samples=16,
    ),
    "shipped": Quality(
        cell_points=64,
        cell_rays=4,
        view_samples=64,
        view_rays=16,
        camera_samples=16,
        camera_rays=8,
        point_replicas=128,
        point_samples=128,
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Codecs:
    """Compression of the four kinds of pictures and the mantissa bits of the radiance in cells.npz."""

    camera: Codec
    view: Codec
    small: Codec
    small_direct: Codec
    cell_mantissa_bits: int


class _Writer:
    """One bundle being written; keeps what scene.json and noise.json will say."""

    def __init__(self, scene: Scene, out: Path, codecs: Codecs) -> None:
        self.scene, self.out, self.codecs = scene, out, codecs
        self.codec_report: dict[str, Any] = {}
        self.noise: dict[str, Any] = {}
        self.radiance = np.array([light.radiance for light in scene.lights])
        self.basis = np.array([light.basis_radiance for light in scene.lights])
        self.exposure = 1.0
        out.mkdir(parents=True, exist_ok=True)
        (out / "small").mkdir(exist_ok=True)

    def picture(self, name: str, radiance: NDArray[Any], codec: Codec, emission: NDArray[np.float32]) -> None:
        path = self.out / name
        write_exr(path, radiance, codec)
        self.codec_report[name] = {"codec": codec.label, **codec_error(path, radiance, emission)}

    def nominal(self, image: RenderedImage) -> NDArray[np.float64]:
        return np.asarray(np.einsum("khwc,kc->hwc", image.total_halves.mean(axis=0), self.radiance))

    def view(self, index: int, background: RenderedImage, composite: RenderedImage) -> None:
        self.noise[f"view{index}"] = view_noise(background, composite, self.radiance, self.basis)
        for kind, image in (("bg", background), ("with", composite)):
            total, direct = image.total_halves.mean(axis=0), image.direct.mean(axis=0)
            small_emission = box_half(np.repeat(image.emission[..., None], 3, axis=-1))[..., 0]
            for k, basis in enumerate(self.basis.tolist()):
                name = f"view{index}_{kind}_light{k}"
                self.picture(f"{name}.exr", total[k] * basis, self.codecs.view, image.emission)
                self.picture(
                    f"small/{name}.exr", box_half(total[k]) * basis, self.codecs.small, small_emission
                )
                self.picture(
                    f"small/{name}_direct.exr",
                    box_half(direct[k]) * basis,
                    self.codecs.small_direct,
                    small_emission,
                )
        write_mask(self.out / f"view{index}_mask.png", composite.coverage)
        if index == 0:
            luminance = self.nominal(background) @ [0.2126, 0.7152, 0.0722]
            self.exposure = 0.9 / float(np.percentile(luminance, 98))
        write_preview(self.out / f"view{index}_preview.jpg", self.nominal(composite), self.exposure)

    def camera(self, index: int, image: RenderedImage) -> None:
        sensor = self.scene.cameras[index]
        inside = np.zeros((sensor.height, sensor.width), dtype=bool)
        inside.flat[pixels_in_circle(sensor)] = True
        self.noise[f"cam{index}"] = camera_noise(image, self.basis, inside)
        total = image.total_halves.mean(axis=0)
        for k, basis in enumerate(self.basis.tolist()):
            self.picture(f"cam{index}_light{k}.exr", total[k] * basis, self.codecs.camera, image.emission)
        write_preview(self.out / f"cam{index}_preview.jpg", self.nominal(image), self.exposure)

    def cells(self, cells: Cells, cache: RadiosityCache) -> None:
        reflected = cache.reflected_radiance * self.basis[None, :, None]
        np.savez_compressed(
            self.out / "cells.npz",
            centre=cells.centre.astype(np.float32),
            normal=cells.normal.astype(np.float16),
            area=cells.area.astype(np.float32),
            quad=(cells.face // 2).astype(np.int16),
            light=cells.light.astype(np.int8),
            valid=cache.exposed > 0.5,
            reflected_radiance=round_mantissa(reflected, self.codecs.cell_mantissa_bits),
            basis_radiance=self.basis,
            albedo=cells.albedo.astype(np.float16),
        )

    def finish(self, quality: Quality, atlas: dict[str, Any]) -> None:
        description = describe_scene(self.scene)
        description["uv_atlas"] = atlas
        description["preview_exposure"] = self.exposure
        description["files"] |= {
            "basis_images": f"EXR half RGB; views {self.codecs.view.label}, cameras {self.codecs.camera.label}, "
            f"small {self.codecs.small.label} (direct: {self.codecs.small_direct.label}); errors under codecs",
            "sampling": {
                "view_spp": quality.view_samples,
                "view_gather_rays": quality.view_samples * quality.view_rays,
                "cam_spp": quality.camera_samples,
                "cam_gather_rays": quality.camera_samples * quality.camera_rays,
                "cell_rays": quality.cell_points * quality.cell_rays,
            },
            "codecs": self.codec_report,
        }
        (self.out / "scene.json").write_text(json.dumps(description, indent=1) + "\n")
        (self.out / "noise.json").write_text(json.dumps(self.noise, indent=1) + "\n")


def choose_points(
    scene: Scene, count: int = NUM_POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Vertices of the virtual objects for point truth: positions (N, 3) and normals (N, 3) in world, object index (N,).

    The count is split evenly over the objects; an object with fewer vertices gives all of them. The choice is fixed by a seed.
    """
    rng = np.random.default_rng(7)
    share = count // max(len(scene.objects), 1)
    positions, normals, owner = [], [], []
    for index, item in enumerate(scene.objects):
        chosen = rng.permutation(len(item.positions))[:share]
        positions.append(item.positions_world[chosen])
        normals.append(item.normals_world[chosen])
        owner.append(np.full(len(chosen), index))
    return np.concatenate(positions), np.concatenate(normals), np.concatenate(owner)


def _write_points(
    writer: _Writer, tracers: dict[str, Tracer], quality: Quality, progress: Callable[[], None]
) -> None:
    scene = writer.scene
    positions, normals, owner = choose_points(scene)
    arrays: dict[str, Any] = {}
    for kind, tracer in tracers.items():
        result = point_irradiance(
            tracer,
            positions,
            normals,
            replicas=quality.point_replicas,
            samples=quality.point_samples,
            gather_rays=quality.point_rays,
            seed=SEED_POINTS,
            progress=progress,
        )
        arrays[f"{kind}_direct"] = result.direct.mean(axis=0)
        arrays[f"{kind}_indirect"] = result.indirect.mean(axis=0)
        writer.noise[f"points_{kind}"] = point_noise(result)
    np.savez_compressed(
        writer.out / "points.npz",
        position=positions,
        normal=normals,
        object=owner,
        object_names=np.array([item.name for item in scene.objects]),
        nominal_radiance=writer.radiance,
        note=np.array(
            "irradiance W/m^2 per unit-radiance white light k. direct[n,K] is colourless; indirect[n,K,3]. E_rgb = sum_k "
            "radiance_k[rgb]*(direct[:,k,None]+indirect[:,k,:]). with_* = objects present, self-occlusion included; bg_* = same point and "
            "normal, objects absent"
        ),
        **arrays,
    )


def count_steps(scene: Scene, quality: Quality) -> int:
    """How often `generate_bundle` calls its progress function."""
    pictures = 2 * len(scene.views) * quality.view_samples + len(scene.cameras) * quality.camera_samples
    return 2 * quality.cell_points + pictures + 2 * quality.point_samples


def generate_bundle(
    backend: Backend,
    scene: Scene,
    out: Path,
    quality: Quality,
    codecs: Codecs,
    *,
    progress: Callable[[], None] = lambda: None,
) -> None:
    """Path-trace a scene and write its bundle.

    Args:
        backend: Mitsuba.
        scene: what to render.
        out: folder, created if missing; files of the same names are replaced.
        quality: sample counts.
        codecs: compression.
        progress: called `count_steps` times.
    """
    writer = _Writer(scene, out, codecs)
    atlas = pack_room(scene)
    write_room_glb(scene, atlas, out / "room.glb")
    for item in scene.objects:
        write_object_glb(item, out / f"{item.name}.glb")
    tracers: dict[str, Tracer] = {}
    for kind in ("bg", "with"):
        geometry = build_geometry(scene, with_objects=kind == "with")
        cells, tracers[kind] = build_cells(scene, geometry), Tracer(backend, scene, geometry)
        cache = solve_radiosity(
            tracers[kind],
            cells,
            points=quality.cell_points,
            rays_per_point=quality.cell_rays,
            seed=SEED_CACHE,
            progress=progress,
        )
        tracers[kind].set_cache(cache.reflected_radiance)
        if kind == "bg":
            writer.cells(cells, cache)
    _write_points(writer, tracers, quality, progress)
    for index, view in enumerate(scene.views):
        pair = [
            render_image(
                tracers[kind],
                view,
                samples=quality.view_samples,
                gather_rays=quality.view_rays,
                seed=SEED_VIEWS + index,
                progress=progress,
            )
            for kind in ("bg", "with")
        ]
        writer.view(index, *pair)
    for index, camera in enumerate(scene.cameras):
        image = render_image(
            tracers["bg"],
            camera,
            samples=quality.camera_samples,
            gather_rays=quality.camera_rays,
            seed=SEED_CAMERAS + index,
            progress=progress,
        )
        writer.camera(index, image)
    writer.finish(quality, atlas.as_json())

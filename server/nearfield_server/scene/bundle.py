"""Evaluation bundles: a path-traced room with every picture per light (`scene.json`), parsed and checked.

Light is linear: `picture = sum_k weight_k * radiance_k / basis_radiance_k * file_k` per channel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nearfield_calibration.models import PinholeIntrinsics
from nearfield_server.errors import AssetError, ConfigError
from nearfield_server.records import CameraModel, TabletView
from nearfield_server.scene.bundle_fields import Fields, read_json

SCENE_FILE = "scene.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleLight:
    """A switchable light of the bundle.

    Attributes:
        name: identifier.
        radiance: (3,) nominal radiance, W/(sr m^2).
        basis_radiance: white radiance that the basis pictures were made with.
    """

    name: str
    radiance: tuple[float, float, float]
    basis_radiance: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleCamera:
    """A fish-eye camera and its basis pictures, one per light."""

    model: CameraModel
    files: tuple[Path, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleView:
    """A tablet view and its truth pictures; tuples hold one file per light and are empty where the bundle has none.

    Attributes:
        model: lens at full size, pose and background file names.
        object_names: virtual objects inserted in the `with_object` pictures.
        background: real scene alone. with_object: with the virtual objects.
        mask: coverage picture of the virtual objects (8 bit), or None.
        small: lens of the half-size pictures, or None.
        small_background, small_with_object: half-size, near-lossless.
        small_direct_background, small_direct_with_object: emission and direct light only.
    """

    model: TabletView
    object_names: tuple[str, ...]
    background: tuple[Path, ...]
    with_object: tuple[Path, ...]
    mask: Path | None
    small: PinholeIntrinsics | None
    small_background: tuple[Path, ...]
    small_with_object: tuple[Path, ...]
    small_direct_background: tuple[Path, ...]
    small_direct_with_object: tuple[Path, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleObject:
    """A virtual object: file, linear albedo (3,), pose (4, 4) float64."""

    name: str
    model_path: Path
    albedo: tuple[float, float, float]
    world_from_object: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleSequence:
    """Light weights over time: (frames, lights) float64 at `fps` frames per second."""

    name: str
    fps: float
    weights: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Bundle:
    """A parsed bundle; every path exists at load time.

    Attributes:
        name: room name. folder: of scene.json.
        model_path: room GLB.
        materials: name -> (3,) linear diffuse albedo.
        points: irradiance truth (npz), or None. cells: radiance atlas truth (npz), or None.
        noise: Monte Carlo noise (json), or None.
    """

    name: str
    folder: Path
    model_path: Path
    materials: dict[str, tuple[float, float, float]]
    lights: tuple[BundleLight, ...]
    cameras: tuple[BundleCamera, ...]
    views: tuple[BundleView, ...]
    objects: tuple[BundleObject, ...]
    sequences: tuple[BundleSequence, ...]
    points: Path | None
    cells: Path | None
    noise: Path | None

    def weights(self, lighting: str = "nominal") -> NDArray[np.float64]:
        """Light weights (lights,) float64 of 'nominal' (all 1) or 'SEQUENCE:FRAME'.

        Raises:
            ConfigError: unknown sequence, or frame out of range; lists what there is.
        """
        if lighting == "nominal":
            return np.ones(len(self.lights))
        name, _, frame = lighting.partition(":")
        sequence = next((sequence for sequence in self.sequences if sequence.name == name), None)
        if sequence is None or not frame:
            known = ", ".join(f"{s.name}:0..{len(s.weights) - 1}" for s in self.sequences)
            raise ConfigError(
                f"lighting {lighting!r}: expected 'nominal' or SEQUENCE:FRAME of {known or 'no sequences'}."
            )
        if not frame.isdecimal() or int(frame) >= len(sequence.weights):
            raise ConfigError(
                f"lighting {lighting!r}: frame: expected 0 to {len(sequence.weights) - 1}, found {frame!r}."
            )
        return np.asarray(sequence.weights[int(frame)])

    def light_factors(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Factors (lights, 3) float64 of the basis pictures for the given weights (lights,)."""
        return light_factors(self.lights, weights)


def light_factors(lights: Sequence[BundleLight], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """weight_k * radiance_k / basis_radiance_k, (lights, 3) float64.

    Raises:
        ConfigError: the number of weights is not that of the lights, or a weight is negative or not finite.
    """
    values = np.asarray(weights, dtype=np.float64)
    if values.shape != (len(lights),):
        raise ConfigError(f"light weights: expected {len(lights)}, found shape {values.shape}.")
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise ConfigError(f"light weights: expected finite numbers >= 0, found {values.tolist()}.")
    radiance = np.array([light.radiance for light in lights], dtype=np.float64)
    basis = np.array([light.basis_radiance for light in lights], dtype=np.float64)
    return np.asarray(values[:, None] * radiance / basis[:, None])


def mix_basis(pictures: Sequence[NDArray[np.floating]], factors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weighted sum of basis pictures.

    Args:
        pictures: one (H, W, 3) picture per light.
        factors: (lights, 3) from `light_factors`.

    Returns:
        (H, W, 3) float64 radiance.
    """
    if len(pictures) != len(factors):
        raise ConfigError(f"basis pictures: expected {len(factors)}, found {len(pictures)}.")
    mixed = np.zeros((*pictures[0].shape[:2], 3), dtype=np.float64)
    for picture, factor in zip(pictures, factors, strict=True):
        if factor.any():
            mixed += picture[..., :3] * factor
    return mixed


def load_bundle(path: str | Path) -> Bundle:
    """Read a bundle.

    Args:
        path: the folder, or its scene.json.

    Raises:
        AssetError: a file is missing or a field is wrong; the message names the file and the key.
    """
    path = Path(path)
    file = path / SCENE_FILE if path.is_dir() else path
    scene = Fields(read_json(file), file)
    materials = {
        name: scene.sub("materials").sub(name).vector("diffuse_albedo")
        for name in scene.sub("materials").names()
    }
    lights = tuple(_light(fields) for fields in scene.items("lights"))
    if not lights:
        raise AssetError(f"{file}:lights: expected at least one light, found none.")
    objects = tuple(_object(fields) for fields in scene.items("objects", required=False))
    known = {item.name for item in objects}
    views = tuple(_view(fields, len(lights), known) for fields in scene.items("views", required=False))
    cameras = tuple(_camera(fields, len(lights)) for fields in scene.items("cameras"))
    if not cameras:
        raise AssetError(f"{file}:cameras: expected at least one camera, found none.")
    files = scene.sub("files") if scene.holds("files", dict) else None
    return Bundle(
        name=scene.text("room"),
        folder=file.parent,
        model_path=scene.file("room_glb"),
        materials=materials,
        lights=lights,
        cameras=cameras,
        views=views,
        objects=objects,
        sequences=tuple(
            _sequence(fields, len(lights)) for fields in scene.items("sequences", required=False)
        ),
        points=_companion(files, file, "points", "points.npz"),
        cells=_companion(files, file, "cells", "cells.npz"),
        noise=_companion(files, file, "noise", "noise.json"),
    )


def _companion(files: Fields | None, scene_file: Path, key: str, default: str) -> Path | None:
    """A truth file: named in `files` (its first word; the rest is a remark for people), or by its usual name."""
    name = files.text(key).split()[0] if files is not None and files.holds(key, str) else default
    path = scene_file.parent / name
    return path if path.is_file() else None


def _light(fields: Fields) -> BundleLight:
    basis = fields.number("basis_radiance", above=0.0)
    return BundleLight(
        name=fields.text("name"), radiance=fields.vector("radiance", at_least=0.0), basis_radiance=basis
    )


def _object(fields: Fields) -> BundleObject:
    return BundleObject(
        name=fields.text("name"),
        model_path=fields.file("glb"),
        albedo=fields.vector("albedo", at_least=0.0, at_most=1.0),
        world_from_object=fields.transform("object_to_world"),
    )


def _camera(fields: Fields, num_lights: int) -> BundleCamera:
    if fields.text("model") == "pinhole":
        raise fields.error("model", "a fish-eye model", "'pinhole'")
    model = CameraModel(
        camera_id=str(fields.scalar("id")),
        intrinsics=fields.fisheye(),
        world_from_camera=fields.transform("camera_to_world"),
    )
    return BundleCamera(model=model, files=fields.files("files", num_lights))


def _view(fields: Fields, num_lights: int, object_names: set[str]) -> BundleView:
    background = fields.files("background", num_lights)
    names = fields.texts("objects") if fields.has("objects") else ()
    unknown = [name for name in names if name not in object_names]
    if unknown:
        raise fields.error("objects", f"names among {sorted(object_names)}", str(unknown))

    def optional(key: str) -> tuple[Path, ...]:
        return fields.files(key, num_lights) if fields.has(key) else ()

    return BundleView(
        model=TabletView(
            view_id=str(fields.scalar("id")),
            intrinsics=fields.pinhole(),
            world_from_camera=fields.transform("camera_to_world"),
            background_files=tuple(fields.texts("background")),
        ),
        object_names=names,
        background=background,
        with_object=optional("with_object"),
        mask=fields.file("mask") if fields.has("mask") else None,
        small=fields.sub("small").pinhole() if fields.has("small") else None,
        small_background=optional("small_background"),
        small_with_object=optional("small_with_object"),
        small_direct_background=optional("small_direct_background"),
        small_direct_with_object=optional("small_direct_with_object"),
    )


def _sequence(fields: Fields, num_lights: int) -> BundleSequence:
    weights = fields.matrix("weights", columns=num_lights)
    if (weights < 0).any():
        raise fields.error("weights", "numbers >= 0", f"{weights.min()}")
    return BundleSequence(name=fields.text("name"), fps=fields.number("fps", above=0.0), weights=weights)

"""scene.json: the description of a bundle, from a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from nearfield_server.virtual_lab.model import Light, Quad, Scene, Sensor, VirtualObject

CONVENTIONS = {
    "world": "right-handed, +y up, interior [0,X]x[0,Y]x[0,Z]",
    "camera": "OpenCV: x right, y down, z forward; camera_to_world maps camera to world",
    "matrices": "row-major 4x4, column vectors",
    "pixels": "pixel centres at integer coordinates, (0,0)=top-left pixel; images stored top row first",
    "surfaces": "all Lambertian, one-sided (back faces black)",
    "fisheye": "theta=angle to +z, phi=atan2(y,x); r=theta*(1+k1 th^2+k2 th^4+k3 th^6+k4 th^8); u=cx+fx*r*cos(phi), "
    "v=cy+fy*r*sin(phi) (OpenCV fisheye); pixels beyond theta_max are 0",
    "basis": "image(t) = sum_k weight_k(t) * radiance_k[rgb] / basis_radiance_k * file_k ; file_k rendered with white light k of "
    "basis_radiance_k, others off",
}


def describe_scene(scene: Scene) -> dict[str, Any]:
    """Everything scene.json says of a scene; file facts are added by the writer."""
    return {
        "room": scene.name,
        "generator": "nearfield virtual lab (Mitsuba 3, llvm_ad_rgb)",
        "units": {
            "length": "m",
            "radiance": "W sr^-1 m^-2 per RGB channel (linear, no spectral weighting)",
            "irradiance": "W m^-2",
        },
        "conventions": CONVENTIONS,
        "size": list(scene.size),
        "materials": {name: {"diffuse_albedo": list(albedo)} for name, albedo in scene.materials.items()},
        "room_glb": "room.glb",
        "lights": [_light(k, light, scene.emitter(k), scene) for k, light in enumerate(scene.lights)],
        "objects": [_object(item) for item in scene.objects],
        "cameras": [_camera(index, camera, len(scene.lights)) for index, camera in enumerate(scene.cameras)],
        "views": [_view(index, view, scene) for index, view in enumerate(scene.views)],
        "sequences": [
            {"name": item.name, "fps": item.fps, "weights": np.round(item.weights, 6).tolist()}
            for item in scene.sequences
        ],
        "files": {
            "points": "points.npz",
            "cells": "cells.npz (perfect radiance atlas of the empty room, one patch per radiosity cell)",
            "noise": "noise.json",
        },
    }


def _light(index: int, light: Light, emitter: Quad, scene: Scene) -> dict[str, Any]:
    return {
        "index": index,
        "name": light.name,
        "radiance": list(light.radiance),
        "kind": light.kind,
        "basis_radiance": light.basis_radiance,
        "geometry": {
            "type": "rectangle, one-sided, Lambertian",
            "p0": emitter.p0.tolist(),
            "e1": emitter.e1.tolist(),
            "e2": emitter.e2.tolist(),
            "normal": emitter.normal.tolist(),
            "area": emitter.area,
        },
        "material": emitter.material,
        "albedo": list(scene.materials[emitter.material]),
    }


def _object(item: VirtualObject) -> dict[str, Any]:
    return {
        "name": item.name,
        "glb": f"{item.name}.glb",
        "vertices": len(item.positions),
        "faces": len(item.faces),
        "albedo": list(item.albedo),
        "object_to_world": item.world_from_object.tolist(),
        "height_m": float(np.ptp(item.positions[:, 1])),
        "shading": "smooth: interpolated GLB vertex normals (area weighted)",
        "source": item.source,
    }


def _lens(sensor: Sensor) -> dict[str, Any]:
    entry: dict[str, Any] = {"model": sensor.model, "width": sensor.width, "height": sensor.height}
    return entry | {"fx": sensor.fx, "fy": sensor.fy, "cx": sensor.cx, "cy": sensor.cy}


def _camera(index: int, camera: Sensor, num_lights: int) -> dict[str, Any]:
    return {
        "id": index,
        **_lens(camera),
        "k": list(camera.k),
        "theta_max_deg": float(np.degrees(camera.theta_max)),
        "camera_to_world": camera.world_from_camera.tolist(),
        "files": [f"cam{index}_light{k}.exr" for k in range(num_lights)],
    }


def _view(index: int, view: Sensor, scene: Scene) -> dict[str, Any]:
    def files(kind: str, folder: str = "", suffix: str = "") -> list[str]:
        return [f"{folder}view{index}_{kind}_light{k}{suffix}.exr" for k in range(len(scene.lights))]

    return {
        "id": index,
        **_lens(view),
        "camera_to_world": view.world_from_camera.tolist(),
        "small": {
            "width": view.width // 2,
            "height": view.height // 2,
            "fx": view.fx / 2,
            "fy": view.fy / 2,
            "cx": (view.cx + 0.5) / 2 - 0.5,
            "cy": (view.cy + 0.5) / 2 - 0.5,
            "note": f"exact 2x2 box average of the {view.width}x{view.height} render",
        },
        "objects": [item.name for item in scene.objects],
        "background": files("bg"),
        "with_object": files("with"),
        "mask": f"view{index}_mask.png",
        "small_background": files("bg", "small/"),
        "small_with_object": files("with", "small/"),
        "small_direct_background": files("bg", "small/", "_direct"),
        "small_direct_with_object": files("with", "small/", "_direct"),
    }

"""What a scene description refuses."""

from __future__ import annotations

import copy
from typing import Any

import pytest
from pydantic import ValidationError

from nearfield_server.gateway.scene_description import SceneDescription

from .conftest import IDENTITY, scene_json

VIEW = {
    "index": 0,
    "id": "view0",
    "width": 960,
    "height": 540,
    "fx": 800.0,
    "fy": 800.0,
    "cx": 479.5,
    "cy": 269.5,
    "world_from_camera": IDENTITY,
    "background_urls": ["assets/views/view0_light0.exr"],
}


def changed(path: str, value: Any) -> dict[str, Any]:
    scene = copy.deepcopy(scene_json())
    scene["views"] = [copy.deepcopy(VIEW)]
    target: Any = scene
    *parents, last = path.split(".")
    for key in parents:
        target = target[int(key) if key.isdigit() else key]
    target[int(last) if last.isdigit() else last] = value
    return scene


def test_json_survives_a_round_trip() -> None:
    scene = SceneDescription.model_validate(changed("room.name", "a <b>"))
    assert SceneDescription.model_validate_json(scene.model_dump_json()) == scene


SCALED = [2.0, *IDENTITY[1:]]
MIRRORED = [-1.0, *IDENTITY[1:]]


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("room.model_url", "../room.glb", "relative URL"),
        ("room.model_url", "assets/../room.glb", "relative URL"),
        ("room.model_url", "http://evil.example/room.glb", "relative URL"),
        ("room.model_url", "/assets/room.glb", "relative URL"),
        ("room.bounds.size", [1, 0, 1], "greater than 0"),
        ("room.bounds.minimum", [0, float("nan"), 0], "finite"),
        ("room.atlas.stream_width", 100, "whole tiles of 32"),
        ("objects.0.index", 1, "indices 0 to 0 in order"),
        ("objects.0.world_from_object", SCALED, "orthonormal axes"),
        ("objects.0.world_from_object", MIRRORED, "right-handed"),
        ("objects.0.world_from_object", [*IDENTITY[:15], 2.0], "last row"),
        ("objects.0.world_from_object", IDENTITY[:12], "16"),
        ("views.0.background_urls", ["assets/a.exr", "assets/b.exr"], "one picture per light"),
        ("lights.0.weight", -1, "greater than or equal to 0"),
        ("surprise", 1, "Extra inputs"),
    ],
)
def test_refusals(path: str, value: Any, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        SceneDescription.model_validate(changed(path, value))

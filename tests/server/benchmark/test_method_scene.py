from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from nearfield_server.benchmark.method_scene import load_method_scene
from nearfield_server.errors import AssetError

TINY = Path(__file__).parents[2] / "data" / "tiny_room"


def test_a_bundle_without_objects_cannot_judge_methods(tmp_path: Path) -> None:
    bundle = tmp_path / "bundle"
    shutil.copytree(TINY, bundle)
    scene = json.loads((bundle / "scene.json").read_text(encoding="utf-8"))
    scene["objects"] = []
    for view in scene["views"]:
        view["objects"] = []
    (bundle / "scene.json").write_text(json.dumps(scene), encoding="utf-8")
    with pytest.raises(AssetError, match="0 objects"):
        load_method_scene(bundle, num_noisy=1, max_views=1, backend="cpu", say=lambda text: None)

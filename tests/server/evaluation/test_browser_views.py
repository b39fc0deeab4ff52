"""The whole way: bundle, pipeline, packet, gateway, real client in Chromium, judgement."""

from __future__ import annotations

import shutil

import cv2
import numpy as np
import pytest

from nearfield_server.evaluation.browser import BROWSER_NAMES
from nearfield_server.evaluation.evaluate import evaluate_bundle
from nearfield_server.gateway.pages import BUILT_CLIENT
from nearfield_server.radiometry import image_metrics

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not any(map(shutil.which, BROWSER_NAMES)), reason="no Chromium"),
    pytest.mark.skipif(not (BUILT_CLIENT / "index.html").is_file(), reason="the client is not built"),
]


def test_views_of_the_tiny_room_are_rendered_and_judged(tiny_room, tmp_path, monkeypatch):
    monkeypatch.setenv("NEARFIELD_CACHE_DIR", str(tmp_path / "cache"))
    report = evaluate_bundle(tiny_room, tmp_path / "out", preset="preview")
    assert [view["id"] for view in report["views"]] == ["0"]
    view = report["views"][0]
    # Against drawing nothing: the empty room leaves shadow_rel_rmse at 1 and looks less like the truth.
    assert view["shadow_rel_rmse"] < 1.0
    shown = {
        kind: cv2.imread(str(tmp_path / "out" / f"view0_{kind}.png")).astype(np.float32) / 255.0
        for kind in ("truth", "background")
    }
    assert view["ssim"] > image_metrics.ssim(shown["truth"], shown["background"])
    assert view["flip_mean"] < image_metrics.flip_mean(shown["truth"], shown["background"])
    assert report["settings"]["browser"].startswith("Chromium")
    for kind in ("composite", "truth", "difference", "background"):
        assert (tmp_path / "out" / f"view0_{kind}.png").is_file()

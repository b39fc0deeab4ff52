"""Truth of views, the page of the report, and the way to the browser."""

from __future__ import annotations

import base64

import numpy as np
import pytest

from nearfield_server.errors import AssetError, ServiceError
from nearfield_server.evaluation import browser
from nearfield_server.evaluation.browser import decode_picture, find_browser
from nearfield_server.evaluation.page_server import serve_bundle
from nearfield_server.evaluation.report_page import ViewPictures, write_report
from nearfield_server.evaluation.view_truth import (
    bundle_exposure,
    emitter_faces,
    emitter_pixels,
    judge_view,
    load_view_truth,
    pinhole_directions,
)
from nearfield_server.scene.bundle import load_bundle
from nearfield_server.scene.exr import read_exr
from nearfield_server.scene.room_model import load_room_mesh


@pytest.fixture(scope="module")
def room(tiny_room):
    bundle = load_bundle(tiny_room)
    mesh = load_room_mesh(bundle.model_path, 256)
    return bundle, mesh, emitter_faces(bundle, mesh)


def test_emitting_faces_are_those_of_the_lights(room, tiny_room):
    _, mesh, emitter = room
    assert emitter.any()
    with np.load(tiny_room / "cells.npz") as cells:
        area = cells["area"][cells["light"] >= 0].sum()
    corners = mesh.positions[mesh.faces[emitter]]
    found = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert found.sum() == pytest.approx(area, rel=1e-3)


def test_pixels_that_see_emitters_are_the_bright_ones_of_the_truth(room):
    # A camera put in front of a light sees it in every pixel; turned away, in none.
    bundle, mesh, emitter = room
    view = bundle.views[0].model
    face = int(np.flatnonzero(emitter)[0])
    a, b, c = mesh.positions[mesh.faces[face]]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    right = np.cross(normal, [0.3, 0.5, 0.8])
    right /= np.linalg.norm(right)
    towards = np.eye(4)
    towards[:3, :3] = np.stack([right, np.cross(-normal, right), -normal], axis=1)
    towards[:3, 3] = (a + b + c) / 3 + 1e-3 * normal
    away = towards.copy()
    away[:3, :3] = np.stack([-right, np.cross(-normal, right), normal], axis=1)
    placed = type(view)(view_id="x", intrinsics=view.intrinsics, world_from_camera=towards)
    assert emitter_pixels(placed, mesh, emitter).all()
    turned = type(view)(view_id="x", intrinsics=view.intrinsics, world_from_camera=away)
    assert emitter_pixels(turned, mesh, emitter).mean() < 0.5
    assert not emitter_pixels(placed, mesh, np.zeros_like(emitter)).any()


def test_directions_go_through_pixel_centres(room):
    lens = room[0].views[0].model.intrinsics
    rays = pinhole_directions(lens).reshape(lens.height, lens.width, 3)
    row, column = 5, 17
    x, y, z = rays[row, column]
    assert lens.fx * x / z + lens.cx == pytest.approx(column)
    assert lens.fy * y / z + lens.cy == pytest.approx(row)


def test_the_truth_judged_by_itself_is_perfect_and_the_empty_room_has_no_shadow(room):
    bundle, mesh, emitter = room
    truth = load_view_truth(bundle, bundle.views[0], bundle.weights(), mesh, emitter)
    exposure = bundle_exposure(bundle)
    assert exposure > 0.0
    perfect = judge_view(truth, truth.truth, exposure)
    assert perfect["object_rel_rmse"] == 0.0
    assert perfect["flip_mean"] == 0.0
    assert perfect["ssim"] == pytest.approx(1.0)
    # The full-size and the half-size background are rounded differently.
    assert perfect["shadow_rel_rmse"] < 0.2
    empty = judge_view(truth, truth.composite_background, exposure)
    assert empty["shadow_rel_rmse"] == pytest.approx(1.0)
    assert empty["object_rel_rmse"] > 0.1


def test_full_size_files_serve_where_small_ones_are_missing(room):
    bundle, mesh, emitter = room
    view = bundle.views[0]
    reduced = type(view)(
        **{
            **{name: getattr(view, name) for name in view.__slots__},
            "small_background": (),
            "small_with_object": (),
            "mask": None,
        }
    )
    whole = load_view_truth(bundle, view, bundle.weights(), mesh, emitter)
    found = load_view_truth(bundle, reduced, bundle.weights(), mesh, emitter)
    np.testing.assert_allclose(found.truth.mean(), whole.truth.mean(), rtol=0.02)
    assert not found.coverage.any()
    without = type(view)(**{**{name: getattr(reduced, name) for name in view.__slots__}, "with_object": ()})
    with pytest.raises(AssetError, match="virtual objects"):
        load_view_truth(bundle, without, bundle.weights(), mesh, emitter)


def test_pictures_come_back_as_they_were_written():
    picture = np.random.default_rng(1).random((3, 5, 4)).astype("<f4")
    answer = {"width": 5, "height": 3, "data": base64.b64encode(picture.tobytes()).decode()}
    np.testing.assert_array_equal(decode_picture(answer), picture)
    with pytest.raises(ServiceError, match="5 x 4"):
        decode_picture({**answer, "height": 4})
    picture[1, 2, 0] = np.nan
    with pytest.raises(ServiceError, match="not finite"):
        decode_picture({**answer, "data": base64.b64encode(picture.tobytes()).decode()})


def test_a_missing_browser_is_named_with_its_package(monkeypatch, tmp_path):
    monkeypatch.setenv(browser.BROWSER_VARIABLE, str(tmp_path / "nothing"))
    with pytest.raises(ServiceError, match="Debian package `chromium`"):
        find_browser()
    monkeypatch.delenv(browser.BROWSER_VARIABLE)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ServiceError, match="--no-views"):
        find_browser()


def test_a_client_that_is_not_built_is_said_so(tmp_path):
    serving = serve_bundle(None, None, 0, None, preset="preview", progress=print, static_dir=tmp_path)
    with pytest.raises(ServiceError, match="npm run build"), serving:
        pass


def test_the_report_shows_every_view_and_escapes_names(tmp_path):
    rng = np.random.default_rng(3)
    pictures = [
        ViewPictures(
            view_id="<b>/7",
            composite=rng.random((4, 6, 3)),
            truth=rng.random((4, 6, 3)),
            background=rng.random((4, 6, 3)),
        )
    ]
    report = {
        "irradiance": {"rel_rmse": 0.123456},
        "views": [
            {"id": "<b>/7", "object_rel_rmse": None, "shadow_rel_rmse": 0.5, "flip_mean": 0.1, "ssim": 0.9}
        ],
        "atlas": None,
        "packet_bytes": 396,
        "stage_ms": {"update": 12.5},
        "settings": {"bundle": "A & B", "lighting": "nominal", "ratio": None, "versions": {"numpy": "2"}},
    }
    write_report(tmp_path / "out", report, pictures, 2.0)
    page = (tmp_path / "out" / "index.html").read_text()
    assert "<b>" not in page
    assert "A &amp; B" in page
    assert "0.1235" in page
    for kind in ("composite", "truth", "difference", "background"):
        assert f'src="view_b__7_{kind}.png"' in page
        assert (tmp_path / "out" / f"view_b__7_{kind}.png").is_file()
    stored = read_exr(tmp_path / "out" / "view_b__7_composite.exr")
    np.testing.assert_array_equal(stored, pictures[0].composite.astype(np.float32))
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(AssetError, match="--out"):
        write_report(blocked / "x", report, [], 1.0)

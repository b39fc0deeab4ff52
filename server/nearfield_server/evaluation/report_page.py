"""Writes the report for people: pictures side by side, and every number."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from nearfield_server.errors import AssetError
from nearfield_server.radiometry.image_metrics import display
from nearfield_server.scene.exr import write_exr

DIFFERENCE_GAIN = 4.0

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 96rem; padding: 0 1rem; color: #1c1f24; background: #fafaf8; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
table { border-collapse: collapse; margin: .5rem 0 1rem; }
td, th { border-bottom: 1px solid #d8d8d2; padding: .25rem .9rem .25rem 0; text-align: left; font-variant-numeric: tabular-nums; }
.row { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(30rem, 100%), 1fr));
  gap: .8rem; }
figure { margin: 0; } img { width: 100%; display: block; background: #000; } figcaption { font-size: .85rem; color: #555a62; }
@media (prefers-color-scheme: dark) {
  body { color: #e4e4de; background: #17191c; } td, th { border-color: #3a3d42; } figcaption { color: #a0a4ab; } }
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewPictures:
    """Linear pictures (H, W, 3) of one view."""

    view_id: str
    composite: NDArray[np.floating]
    truth: NDArray[np.floating]
    background: NDArray[np.floating]


def write_report(
    out: Path, report: dict[str, Any], pictures: Sequence[ViewPictures], exposure: float
) -> None:
    """Write report.json, EXR and PNG pictures and index.html.

    Args:
        out: folder, made if it is not there.
        report: plain numbers, strings, lists and dictionaries.
        pictures: of every judged view.
        exposure: display exposure of all pictures.

    Raises:
        AssetError: the folder cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        for view in pictures:
            _write_pictures(out, view, exposure)
        (out / "report.json").write_text(
            json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )
        (out / "index.html").write_text(render_page(report, pictures), encoding="utf-8")
    except OSError as error:
        raise AssetError(
            f"{out}: cannot be written ({error.strerror}); choose another folder with --out."
        ) from error


def render_page(report: dict[str, Any], pictures: Sequence[ViewPictures]) -> str:
    """The whole page; pictures are referred to by file name."""
    settings = report["settings"]
    parts = [
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>Evaluation of {html.escape(str(settings['bundle']))}</title><style>{_STYLE}</style>",
        f"<h1>Evaluation of {html.escape(str(settings['bundle']))}, lighting {html.escape(str(settings['lighting']))}</h1>",
    ]
    for title, key in (("Irradiance on virtual objects", "irradiance"), ("Radiance atlas", "atlas")):
        parts.append(
            f"<h2>{title}</h2>"
            + _table(report[key] if report[key] is not None else {"not judged": "no truth in the bundle"})
        )
    errors = {str(entry["id"]): entry for entry in report["views"]}
    for view in pictures:
        name = html.escape(view.view_id)
        parts.append(
            f"<h2>View {name}</h2>" + _table({k: v for k, v in errors[view.view_id].items() if k != "id"})
        )
        captions = (
            ("composite", "what the client shows"),
            ("truth", "path-traced truth"),
            ("difference", f"absolute difference x {DIFFERENCE_GAIN:g}"),
            ("background", "without virtual objects"),
        )
        figures = (
            f'<figure><img src="{_file(view.view_id, kind)}.png" alt="{text}, view {name}"><figcaption>{text}</figcaption></figure>'
            for kind, text in captions
        )
        parts.append('<div class="row">' + "".join(figures) + "</div>")
    if not pictures:
        parts.append("<h2>Views</h2><p>No view was rendered.</p>")
    parts.append(
        "<h2>Cost</h2>"
        + _table(
            {
                "packet_bytes": report["packet_bytes"],
                **{f"{k} (ms)": v for k, v in report["stage_ms"].items()},
            }
        )
    )
    parts.append("<h2>Settings</h2>" + _table(settings))
    return "\n".join(parts) + "</html>\n"


def _table(values: dict[str, Any]) -> str:
    rows = (
        f"<tr><th>{html.escape(key)}</th><td>{html.escape(_text(value))}</td></tr>"
        for key, value in values.items()
    )
    return "<table>" + "".join(rows) + "</table>"


def _text(value: object) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "not defined here"}[value]
    if isinstance(value, float):
        return f"{value:.4g}"
    return ", ".join(f"{k} {_text(v)}" for k, v in value.items()) if isinstance(value, dict) else str(value)


def _file(view_id: str, kind: str) -> str:
    safe = "".join(c if c.isalnum() or c in "-_" else "_" for c in view_id)
    return f"view{safe}_{kind}"


def _write_pictures(out: Path, view: ViewPictures, exposure: float) -> None:
    difference = np.abs(np.asarray(view.composite) - np.asarray(view.truth))
    linear = {
        "composite": (view.composite, 1.0),
        "truth": (view.truth, 1.0),
        "difference": (difference, DIFFERENCE_GAIN),
        "background": (view.background, 1.0),
    }
    for kind, (picture, gain) in linear.items():
        path = out / _file(view.view_id, kind)
        if kind in ("composite", "truth"):
            write_exr(path.with_suffix(".exr"), np.asarray(picture, np.float32), half=False)
        shown = np.rint(255.0 * display(np.asarray(picture), exposure * gain)).astype(np.uint8)
        if not cv2.imwrite(str(path.with_suffix(".png")), shown[..., ::-1]):
            raise AssetError(f"{path}.png: cannot be written; choose another folder with --out.")

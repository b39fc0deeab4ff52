"""The page of a benchmark run: tables, plots and pictures in one file, and the plots as files of their own."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from nearfield_server.benchmark import plots
from nearfield_server.benchmark.method_sweep import PICTURES
from nearfield_server.benchmark.methods import METHODS
from nearfield_server.benchmark.paper_times import PAPER_STAGE_MS
from nearfield_server.benchmark.summary import METHOD_FIGURES, markdown_table, number
from nearfield_server.errors import AssetError

_STYLE: Final = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 76rem; padding: 0 1rem; color: #1c1f24; background: #fff; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.2rem; margin-top: 2.4rem; } h3 { font-size: 1rem; margin-top: 1.6rem; }
p { max-width: 48rem; } table { border-collapse: collapse; margin: .5rem 0 1rem; font-variant-numeric: tabular-nums; }
td, th { border-bottom: 1px solid #d8d8d2; padding: .2rem .8rem .2rem 0; text-align: left; } td.n, th.n { text-align: right; }
tr.own td { font-weight: 600; } svg { max-width: 100%; height: auto; } .wide { overflow-x: auto; }
.pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(15rem, 1fr)); gap: .7rem; }
figure { margin: 0; } img { width: 100%; display: block; } figcaption { font-size: .85rem; color: #555a62; }
"""
_HEADINGS: Final = {
    "irradiance_rel_rmse": "irradiance",
    "object_rel_rmse": "object",
    "shadow_rel_rmse": "shadow",
    "flip": "FLIP",
    "flicker": "flicker / 255",
    "server_ms": "server CPU ms",
    "client_ms": "client CPU ms",
    "bytes": "bytes",
}
_GROWTH: Final[dict[str, tuple[str, str, dict[str, str]]]] = {
    "fig11_objects": (
        "Cost against the number of objects (Rohmer et al. 2014, Figure 11)",
        "",
        {"server_objects": "objects, light update", "virtual_objects": "objects, frame"},
    ),
    "fig12_screen": (
        "Frame against screen size (Figure 12)",
        "of a frame",
        {"screen_pixels": "pixels"},
    ),
    "fig13_lights": (
        "Cost against the number of lights (Figure 13)",
        "",
        {"vals": "lights, frame", "server_vals": "lights, light update"},
    ),
    "fig14_triangles": (
        "Frame against triangles (Figure 14)",
        "of a frame",
        {"object_triangles": "triangles"},
    ),
    "growth_server": (
        "Light update against atlas and cameras",
        "of an update",
        {"atlas_texels": "texels", "camera_pixels": "pixels of a camera", "cameras": "cameras"},
    ),
    "growth_clients": (
        "Gateway against connected clients",
        "per update",
        {"connected_clients": "clients"},
    ),
}


def write_page(out: Path, report: dict[str, Any]) -> Path:
    """Write index.html, plots/*.svg and methods.md (one table for a document) from the content of bench.json.

    Returns:
        The page.

    Raises:
        AssetError: the folder cannot be written.
    """
    figures = draw_plots(report)
    page = out / "index.html"
    try:
        folder = out / "plots"
        folder.mkdir(parents=True, exist_ok=True)
        for name, svg in figures.items():
            (folder / f"{name}.svg").write_text(svg, encoding="utf-8")
        if isinstance(report["methods"], list):
            (out / "methods.md").write_text(markdown_table(report["methods"]), encoding="utf-8")
        page.write_text(_page(out, report, figures), encoding="utf-8")
    except OSError as error:
        raise AssetError(f"{out}: cannot be written ({error.strerror}); choose another --out") from error
    return page


def draw_plots(report: dict[str, Any]) -> dict[str, str]:
    """Every plot that the run has figures for: file name without ending -> SVG."""
    figures = {}
    for bundle, rows in _by_bundle(report).items():
        safe = _safe(bundle)
        figures[f"{safe}_error_against_time"] = plots.error_against_time(rows)
        figures[f"{safe}_error_against_bytes"] = plots.error_against_bytes(rows)
        figures[f"{safe}_fig10_error_by_lights"] = plots.error_by_lights(rows)
        figures[f"{safe}_flicker"] = plots.flicker_by_lights(rows)
    for name, (_, what, names) in _GROWTH.items():
        found = {key: words for key, words in names.items() if key in report["growth"]}
        if found:
            figures[name] = plots.growth(report["growth"], found, what)
    return figures


def _page(out: Path, report: dict[str, Any], figures: dict[str, str]) -> str:
    parts = [
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>Nearfield benchmark</title><style>{_STYLE}</style><h1>Run time against error</h1>",
        _methods(out, report, figures),
        "<h2>What each ingredient brings</h2>",
        _plain(report["ablation"]),
        _server(report["server"]),
        _capture(report["capture"]),
        _client(report["client"]),
        _growth(report["growth"], figures),
        "<h2>Steadiness in time</h2>",
        _temporal(report["temporal"]),
        "<h2>Latency</h2>",
        _plain(report["latency"]),
        "<h2>This run</h2>",
        _plain({"machine": report["machine"], "versions": report["versions"]}),
        _list([{"part": name} | _flat(state) for name, state in report["parts"].items()]),
        "</html>\n",
    ]
    return "\n".join(parts)


def _methods(out: Path, report: dict[str, Any], figures: dict[str, str]) -> str:
    if not isinstance(report["methods"], list):
        return "<h2>Methods</h2>" + _plain(report["methods"])
    parts = [
        "<h2>Methods</h2><p>Errors against path-traced truth, 0 is perfect; shadow 1 means that none is drawn. Server: CPU time of one "
        "light update. Client: CPU time of Chromium's GPU process for one full frame on a software rasteriser. All methods but Nearfield "
        "are baselines, built as printed with known errors of the papers corrected, and drawn by the same renderer; more than 64 "
        "lights are drawn in turns of 64 whose differences to the unlit picture are added. The cube map of the WebXR model is not counted: "
        "diffuse objects need only its SH and its directional light.</p>"
    ]
    for bundle, rows in _by_bundle(report).items():
        parts += [f"<h3>{html.escape(bundle)}</h3>", _method_table(rows), _pictures(out, bundle, rows)]
        for kind, words in (
            ("error_against_time", "Error against time; small numbers are lights"),
            ("error_against_bytes", "Error against bytes"),
            ("fig10_error_by_lights", "Error by number of lights (Rohmer et al. 2014, Figure 10)"),
            ("flicker", "Flicker of a still room under one per cent of camera noise"),
        ):
            parts.append(f"<h3>{words}, {html.escape(bundle)}</h3>{figures[f'{_safe(bundle)}_{kind}']}")
    return "\n".join(parts)


def _method_table(rows: Sequence[dict[str, Any]]) -> str:
    head = "".join(f'<th class="n">{_HEADINGS[key]}</th>' for key in METHOD_FIGURES)
    lines = [f'<tr><th>method</th><th class="n">lights</th>{head}<th>printed in</th></tr>']
    order = list(METHODS)
    for row in sorted(rows, key=lambda row: (order.index(row["name"]), row["lights"])):
        entry = METHODS[row["name"]]
        cells = "".join(f'<td class="n">{number(row[key])}</td>' for key in METHOD_FIGURES)
        lines.append(
            f'<tr{"" if entry.source else " class=own"}><td>{html.escape(entry.title)}</td><td class="n">{row["lights"]}</td>'
            f"{cells}<td>{html.escape(entry.source)}</td></tr>"
        )
    return f'<div class="wide"><table>{"".join(lines)}</table></div>'


def _pictures(out: Path, bundle: str, rows: Sequence[dict[str, Any]]) -> str:
    """First view under every method, at the number of lights nearest to 16, and the truth."""
    shown = [("truth", "path-traced truth")]
    for name, entry in METHODS.items():
        own = [row["lights"] for row in rows if row["name"] == name]
        if own:
            lights = min(own, key=lambda count: abs(count - 16))
            shown.append((f"{name}_{lights}", f"{entry.title}, {lights} lights" if lights else entry.title))
    figures = []
    for suffix, caption in shown:
        path = out / PICTURES / f"{bundle}_{suffix}.jpg"
        if path.is_file():
            data = base64.b64encode(path.read_bytes()).decode("ascii")
            figures.append(
                f'<figure><img alt="{html.escape(caption)}" src="data:image/jpeg;base64,{data}">'
                f"<figcaption>{html.escape(caption)}</figcaption></figure>"
            )
    return f'<div class="pictures">{"".join(figures)}</div>'


def _server(section: dict[str, Any]) -> str:
    if "stage_cpu_ms" not in section:
        return "<h2>Light update</h2>" + _plain(section)
    lines = [
        '<tr><th>stage</th><th class="n">Nearfield, CPU ms</th><th class="n">GTX 580 of the paper, ms</th>'
        "<th>what the paper does there</th></tr>"
    ]
    for stage, cpu_ms in section["stage_cpu_ms"].items():
        words, paper_ms = PAPER_STAGE_MS.get(stage, ("", None))
        lines.append(
            f'<tr><td>{html.escape(stage)}</td><td class="n">{number(cpu_ms)}</td><td class="n">{number(paper_ms)}</td>'
            f"<td>{html.escape(words)}</td></tr>"
        )
    ratios = {key: value for key, value in section.items() if isinstance(value, int | float)}
    return (
        "<h2>Light update, stage by stage (Rohmer et al. 2014, Table 1)</h2>"
        f"<table>{''.join(lines)}</table><h3>Ratios within one run</h3>" + _plain(ratios)
    )


def _capture(section: dict[str, Any]) -> str:
    if "cpu_ms" not in section:
        return "<h2>Pictures</h2>" + _plain(section)
    steps = [
        {"step": name.replace("_", " "), "CPU ms": cost, "copies": section["to_copy"].get(name, 1.0)}
        for name, cost in section["cpu_ms"].items()
    ]
    rest = {name: section[name] for name in ("picture", "bytes_per_pixel", "errors", "raw_bits_changed")}
    return f"<h2>Pictures, from the sensor to ring and disk</h2>{_list(steps)}{_plain(rest)}"


def _client(section: dict[str, Any]) -> str:
    ratios = {key: value for key, value in section.items() if isinstance(value, int | float | str)}
    return "<h2>Frame of the client: ratios within one run</h2>" + _plain(ratios)


def _growth(section: dict[str, Any], figures: dict[str, str]) -> str:
    parts = ["<h2>Cost against size</h2>"]
    if "missing" in section:
        parts.append(_plain({"missing": section["missing"]}))
    parts += [
        f"<h3>{words}</h3>{figures[name]}" for name, (words, _, _) in _GROWTH.items() if name in figures
    ]
    return "\n".join(parts)


def _temporal(section: dict[str, Any]) -> str:
    rooms = section.get("rooms")
    return _plain(section) if rooms is None else _list([_flat(room) for room in rooms])


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    """Without what is nested: bench.json has it."""
    return {key: value for key, value in values.items() if not isinstance(value, dict | list)}


def _plain(value: Any) -> str:
    """Nested values as nested tables."""
    if isinstance(value, dict):
        return "<table>" + "".join(_rows(value.items())) + "</table>"
    if isinstance(value, float):
        return number(value)
    if isinstance(value, list):
        return _list(value)
    return html.escape(str(value))


def _list(values: list[Any]) -> str:
    """Dictionaries as lines of one table, anything else in one line."""
    if not values or not all(isinstance(value, dict) for value in values):
        return ", ".join(_plain(value) for value in values)
    columns = list(dict.fromkeys(key for value in values for key in value))
    head = "".join(f"<th>{html.escape(str(key))}</th>" for key in columns)
    lines = ("".join(f"<td>{_plain(value.get(key, ''))}</td>" for key in columns) for value in values)
    return f"<table><tr>{head}</tr>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def _rows(items: Iterable[tuple[str, Any]]) -> Iterable[str]:
    for key, value in items:
        yield f"<tr><th>{html.escape(str(key))}</th><td>{_plain(value)}</td></tr>"


def _by_bundle(report: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    rows = report["methods"] if isinstance(report["methods"], list) else []
    return {
        bundle: [row for row in rows if row["bundle"] == bundle]
        for bundle in dict.fromkeys(row["bundle"] for row in rows)
    }


def _safe(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in name)

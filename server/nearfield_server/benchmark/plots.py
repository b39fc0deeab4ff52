"""Plots of a benchmark run as SVG: error against time and bytes, and the papers' figures with numbers."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from nearfield_server.benchmark.methods import METHODS

Row = dict[str, Any]
ERRORS: Final = {
    "irradiance_rel_rmse": "irradiance on objects, relative RMSE",
    "object_rel_rmse": "objects in the picture, relative RMSE",
    "shadow_rel_rmse": "shadows on real surfaces, relative RMSE",
    "flip": "FLIP of the whole picture",
}
_OWN: Final = "nearfield"
# Okabe and Ito's colours, told apart by all common forms of colour vision; markers repeat the difference.
_STYLES: Final = {
    "nearfield": ("#000000", "o"),
    "vpl": ("#E69F00", "s"),
    "vpl_split": ("#B8860B", "D"),
    "clustered_vpl": ("#56B4E9", "^"),
    "split_cluster": ("#0072B2", "v"),
    "prt_only": ("#009E73", "P"),
    "webxr": ("#D55E00", "X"),
    "pessoa": ("#CC79A7", "<"),
    "gierlinger": ("#5F7F3F", "*"),
}
_RC: Final[Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "nearfield",
    "font.size": 9.5,
    "font.family": "sans-serif",
}
_LONG: Final = 1000
# An axis that spans less than the range gets ticks at these multiples of powers of ten.
_RANGES: Final = (5.0, 300.0, math.inf)
_SUBS: Final = ((1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0), (1.0, 2.0, 5.0), (1.0,))


@mpl.rc_context(_RC)
def error_against_time(rows: Sequence[Row]) -> str:
    """Four errors of one bundle against the CPU time of one update and one frame."""
    return _panels(rows, lambda row: row["server_ms"] + row["client_ms"], "CPU ms of an update and a frame")


@mpl.rc_context(_RC)
def error_against_bytes(rows: Sequence[Row]) -> str:
    """Four errors of one bundle against the bytes of one update."""
    return _panels(rows, lambda row: row["bytes"], "bytes per update")


@mpl.rc_context(_RC)
def error_by_lights(rows: Sequence[Row]) -> str:
    """Four errors of one bundle by number of lights: Rohmer et al. 2014, Figure 10, with numbers.

    Methods without a choice of lights are level lines.
    """
    return _panels(rows, lambda row: row["lights"], "lights", by_lights=True)


@mpl.rc_context(_RC)
def flicker_by_lights(rows: Sequence[Row]) -> str:
    """Temporal flicker under one per cent of camera noise."""
    figure = _figure(9.2, 4.4)
    axes = figure.subplots()
    _draw(axes, rows, lambda row: row["lights"], "flicker", by_lights=True)
    axes.axhline(1.0, color="#999999", linewidth=0.8, linestyle=":")
    _label(axes, "lights", "flicker, 1/255 of the display's range", ticks=_light_ticks(rows))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return _svg(figure)


@mpl.rc_context(_RC)
def growth(entries: dict[str, dict[str, Any]], names: dict[str, str], what: str) -> str:
    """Cost against the size of several things, with the fitted exponent of each.

    Args:
        entries: of bench.json's `growth`: `x`, `cpu_ms`, `exponent`.
        names: of those to draw, and their words.
        what: the cost is of.
    """
    figure = _figure(3.1 * len(names) + 0.3, 2.9)
    panels = figure.subplots(1, len(names), squeeze=False)[0]
    for axes, (name, words) in zip(panels, names.items(), strict=True):
        entry = entries[name]
        axes.plot(entry["x"], entry["cpu_ms"], marker="o", color="#0072B2", linewidth=1.4)
        axes.set_title(f"{words}: exponent {entry['exponent']:.2f}", fontsize=9.5)
        _label(axes, words, f"CPU ms {what}", ticks=_ticks(entry["x"]))
    return _svg(figure)


def _panels(
    rows: Sequence[Row], x_of: Callable[[Row], float], x_label: str, *, by_lights: bool = False
) -> str:
    figure = _figure(9.2, 7.0)
    panels = figure.subplots(2, 2).reshape(-1)
    for axes, (key, words) in zip(panels, ERRORS.items(), strict=True):
        _draw(axes, rows, x_of, key, by_lights=by_lights)
        _label(axes, x_label, words, ticks=_light_ticks(rows) if by_lights else ())
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return _svg(figure)


def _draw(
    axes: Axes, rows: Sequence[Row], x_of: Callable[[Row], float], key: str, *, by_lights: bool
) -> None:
    for name, (colour, marker) in _STYLES.items():
        own = sorted((row for row in rows if row["name"] == name), key=lambda row: int(row["lights"]))
        points = [(x_of(row), row[key], row["lights"]) for row in own if row[key] is not None]
        if not points:
            continue
        label = METHODS[name].title
        style: dict[str, Any] = {"color": colour, "linewidth": 2.2 if name == _OWN else 1.1, "label": label}
        if by_lights and len(METHODS[name].light_counts) == 1:
            axes.axhline(points[0][1], linestyle="--", **style)
            continue
        x, y, lights = zip(*points, strict=True)
        axes.plot(x, y, marker=marker, markersize=7 if name == _OWN else 5.5, **style)
        if not by_lights and len(points) > 1:
            for at in (0, -1):
                axes.annotate(
                    str(lights[at]),
                    (x[at], y[at]),
                    (3, 3),
                    textcoords="offset points",
                    fontsize=7,
                    color=colour,
                )


def _light_ticks(rows: Sequence[Row]) -> list[float]:
    return _ticks([row["lights"] for row in rows if row["lights"] > 1])


def _label(axes: Axes, x_label: str, y_label: str, *, ticks: Sequence[float] = ()) -> None:
    """Both axes logarithmic, plain numbers, few ticks; `ticks` are those of x, or none for round numbers."""
    for axis, scale in ((axes.xaxis, axes.set_xscale), (axes.yaxis, axes.set_yscale)):
        scale("log")
        low, high = axis.get_view_interval()
        axis.set_major_locator(
            LogLocator(subs=_SUBS[next(i for i, r in enumerate(_RANGES) if high < r * low)])
        )
        axis.set_major_formatter(FuncFormatter(lambda value, _: _short(value)))
        axis.set_minor_locator(NullLocator())
    if ticks:
        axes.set_xticks(ticks, [_short(value) for value in ticks])
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.grid(visible=True, which="major", color="#dddddd", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _ticks(values: Sequence[float]) -> list[float]:
    """At the measured sizes, or at the first and last where their numbers are long."""
    distinct = sorted(set(values))
    return distinct if max(distinct) <= _LONG else [distinct[0], distinct[-1]]


def _short(value: float) -> str:
    for limit, unit in ((1e6, "M"), (1e4, "k")):
        if value >= limit:
            return f"{value / (1e6 if unit == 'M' else 1e3):.3g} {unit}"
    return f"{value:g}"


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), layout="constrained", facecolor="white")


def _svg(figure: Figure) -> str:
    """The figure without its XML head, to stand within a page or a file of its own."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]

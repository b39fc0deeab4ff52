"""The parts of `nearfield bench`: what each needs, and where its figures come from.

A part is a function of a `BenchSetup` that returns the content of its section of bench.json: a dictionary, or a list of rows.
It is imported when it runs, so that a part whose extra is not installed costs the run that part and nothing else.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from nearfield_server.pipeline.runner import BackendName

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchSetup:
    """What all parts are told.

    Attributes:
        quick: fewer rounds, views and frames: the whole command stays under ten minutes on two cores.
        tiny: the smallest form that still runs everything, to prove that it works; its figures say nothing.
        bundles: with path-traced truth.
        backend: of the light pipeline under test.
        resume: keep what an interrupted run in the same folder finished.
        out: folder of the run; a part may keep files of its own there.
        say: told in words what is being done.
    """

    quick: bool
    tiny: bool
    bundles: tuple[Path, ...]
    backend: BackendName
    resume: bool
    out: Path
    say: Progress


@dataclass(frozen=True, slots=True)
class PartEntry:
    """Where a part lives, and what it measures."""

    module: str
    attribute: str
    summary: str


PARTS: Final[dict[str, PartEntry]] = {
    "server": PartEntry(
        "nearfield_server.benchmark.sections", "server_section", "stages of the light pipeline"
    ),
    "capture": PartEntry(
        "nearfield_server.benchmark.sections", "capture_section", "pictures from the sensor to ring and disk"
    ),
    "client": PartEntry(
        "nearfield_server.benchmark.sections", "client_section", "frames of the client and of other renderers"
    ),
    "methods": PartEntry(
        "nearfield_server.benchmark.method_sweep",
        "methods_section",
        "error against time and bytes of every method",
    ),
    "ablation": PartEntry(
        "nearfield_server.benchmark.sections", "ablation_section", "what each ingredient of the method brings"
    ),
    "growth": PartEntry(
        "nearfield_server.benchmark.sections", "growth_section", "cost against the size of everything"
    ),
    "temporal": PartEntry(
        "nearfield_server.benchmark.sections", "temporal_section", "how steady the light is in time"
    ),
    "latency": PartEntry(
        "nearfield_server.benchmark.sections",
        "latency_section",
        "from a captured frame to the packet and the pixel",
    ),
}


def load_part(name: str) -> Callable[[BenchSetup], Any]:
    """Import a part.

    Raises:
        ModuleNotFoundError: a package of its extra is missing.
    """
    entry = PARTS[name]
    part: Callable[[BenchSetup], Any] = getattr(importlib.import_module(entry.module), entry.attribute)
    return part

"""Runs the parts of the benchmark one after the other and keeps bench.json up to date after each of them."""

from __future__ import annotations

import json
import os
import platform
import time
import traceback
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import numpy as np

from nearfield_server.benchmark.assembly_files import write_json
from nearfield_server.benchmark.parts import PARTS, BenchSetup, load_part
from nearfield_server.errors import AssetError, NearfieldError

FORMAT: Final = 1
_PACKAGES: Final = (
    "nearfield",
    "numpy",
    "numba",
    "scipy",
    "moderngl",
    "embreex",
    "playwright",
    "flip-evaluator",
)


def run_parts(setup: BenchSetup, names: Sequence[str]) -> dict[str, Any]:
    """Run parts and write bench.json after each.

    A part that fails is noted with its reason, and the others still run. An interrupted run keeps what it finished.

    Args:
        setup: for all parts.
        names: which parts, in this order; results of other parts that bench.json already holds stay in it. With
            `setup.resume` those are left out that it holds from a run with the same settings.

    Returns:
        The content of bench.json.

    Raises:
        AssetError: bench.json cannot be read or written.
    """
    path = setup.out / "bench.json"
    report = _former(path)
    settings = _settings(setup)
    finished = {
        name
        for name, state in report.get("parts", {}).items()
        if state["state"] == "done" and state["settings"] == settings
    }
    report = {name: _not_run() for name in PARTS} | {"parts": {}} | report
    report |= {"format": FORMAT, "machine": machine(), "versions": versions()}
    for name in names:
        if setup.resume and name in finished:
            setup.say(f"{name}: kept from the former run")
            continue
        setup.say(f"{name}: {PARTS[name].summary}")
        started, begun = time.monotonic(), datetime.now(UTC).isoformat(timespec="seconds")
        state, section = _run_part(setup, name)
        seconds = time.monotonic() - started
        report[name] = section
        report["parts"][name] = state | {
            "started": begun,
            "seconds": round(seconds, 1),
            "settings": settings,
        }
        write_json(path, report)
        setup.say(f"{name}: {state['state']} after {seconds:.0f} s")
    return report


def failed_parts(report: dict[str, Any], names: Sequence[str]) -> dict[str, str]:
    """Reasons of the parts that failed, by name."""
    return {
        name: str(report["parts"][name]["reason"])
        for name in names
        if report["parts"].get(name, {}).get("state") == "failed"
    }


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    return {
        "cpus": len(os.sched_getaffinity(0)),
        "processor": _processor(),
        "system": f"{platform.system()} {platform.release()}",
        "load_before": round(os.getloadavg()[0], 2),
    }


def versions() -> dict[str, str]:
    """Python and the packages that do the work."""
    found = {"python": platform.python_version(), "numpy": np.__version__}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def _run_part(setup: BenchSetup, name: str) -> tuple[dict[str, Any], Any]:
    """State and section of one part; every failure ends up in words."""
    try:
        section = load_part(name)(setup)
    except ModuleNotFoundError as error:
        reason = f"needs the Python module '{error.name}', which is not installed"
    except NearfieldError as error:
        reason = str(error)
    except Exception as error:
        # A fault in one part must not cost hours of the others; the place is kept for whoever repairs it.
        place = traceback.extract_tb(error.__traceback__)[-1]
        reason = f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
    else:
        return {"state": "done", "reason": ""}, section
    return {"state": "failed", "reason": reason}, {"missing": reason}


def _not_run() -> dict[str, Any]:
    return {"missing": "not part of this run"}


def _settings(setup: BenchSetup) -> dict[str, Any]:
    return {
        "quick": setup.quick,
        "tiny": setup.tiny,
        "backend": setup.backend,
        "bundles": [path.name for path in setup.bundles],
    }


def _former(path: Path) -> dict[str, Any]:
    """The content of an earlier run in the same folder, or nothing."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise AssetError(f"{path}: cannot be read ({error}); remove it or choose another --out") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        return {}
    return content


def _processor() -> str:
    """Name of the processor, or its architecture where the system does not tell."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()

"""What a frame of the client costs next to other renderers: CPU time of Chromium's GPU process, software rasterisers.

Variants take turns within every round, so that the ratios of a round hold on a busy machine; results are medians over rounds.
What each variant draws, and what a full frame is: client_web/bench/variant.ts. How lights become those of other engines: lights.ts.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

from nearfield_server.benchmark.client_page import (
    RASTERISERS,
    BenchPage,
    FrameCost,
    open_bench_page,
    require_built_page,
)
from nearfield_server.benchmark.client_scene import LAB, ClientScene, client_scene
from nearfield_server.benchmark.ratios import ratio_spread, spread

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """A renderer, its number of VAL slots, and what changes in each frame."""

    maker: str
    slots: int
    kind: str = "full"

    @property
    def key(self) -> str:
        """Variants with the same key share one context."""
        return f"{self.maker}{self.slots}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """How much is measured: interleaved rounds, frames per sample, and the size of the pictures in pixels."""

    rounds: int
    frames: int
    width: int = 960
    height: int = 540


RATIOS: Final = {
    "frame_over_three16": ("ours16", "three16"),
    "frame_over_differential": ("ours16", "differential16"),
    "frame_over_playcanvas16": ("ours16", "playcanvas16"),
    "frame_over_playcanvas64": ("ours64", "playcanvas64"),
    "vals64_over_vals16": ("ours64", "ours16"),
    "video_only_over_full": ("ours16_video", "ours16"),
}
"""Reported ratios of GPU-process CPU time."""
EXTRA_RATIOS: Final = {"frame_over_playcanvas64_same_maps": ("ours64", "playcanvas64_same_maps")}
"""Against a PlayCanvas that redraws no more shadow maps per frame than ours: what the budget alone brings."""
BREAKDOWN: Final = ("video", "light colour", "lights moved", "objects moved", "camera")
"""One thing changes per frame: what a frame of ours costs then."""

_FULL: Final = {"llvmpipe": Plan(rounds=11, frames=2), "swiftshader": Plan(rounds=7, frames=1)}
_QUICK: Final = {"llvmpipe": Plan(rounds=3, frames=1), "swiftshader": Plan(rounds=2, frames=1)}
_TINY: Final = {name: Plan(rounds=1, frames=1, width=96, height=54) for name in RASTERISERS}


def make_variants(few: int, many: int) -> dict[str, Variant]:
    """All variants, by the names that stand for 16 and 64 VALs.

    Args:
        few: slots of the variants named 16.
        many: slots of the variants named 64.
    """
    return {
        "ours16": Variant(maker="ours", slots=few),
        "ours64": Variant(maker="ours", slots=many),
        "ours16_video": Variant(maker="ours", slots=few, kind="video"),
        "three16": Variant(maker="three", slots=few),
        "differential16": Variant(maker="differential", slots=few),
        "playcanvas16": Variant(maker="playcanvas", slots=few),
        "playcanvas64": Variant(maker="playcanvas", slots=many),
        "playcanvas64_same_maps": Variant(maker="playcanvas", slots=many, kind="same maps"),
    }


def measure_client(out: Path, quick: bool, progress: Progress, *, tiny: bool = False) -> dict[str, Any]:
    """Time all variants on both software rasterisers.

    Args:
        out: existing folder; a picture of every variant is written there.
        quick: fewer rounds, for about two minutes in all.
        progress: called with a line of text before each step.
        tiny: proves that everything runs, with few lights and small pictures; the figures say nothing.

    Returns:
        The ratios (medians on llvmpipe), and `rasterisers`: per rasteriser the ratios, their `spread`, and `cpu_ms` per variant.

    Raises:
        ServiceError: the page is not built, there is no browser, or the page fails.
    """
    require_built_page()
    variants = make_variants(2, 4) if tiny else make_variants(16, 64)
    if quick and not tiny:
        variants = {name: each for name, each in variants.items() if each.kind != "same maps"}
    plans = _TINY if tiny else _QUICK if quick else _FULL
    scene = client_scene(LAB, sorted({variant.slots for variant in variants.values()}), progress)
    rasterisers = {
        name: measure_on(scene, name, variants, plan, out, progress) for name, plan in plans.items()
    }
    return {**{name: rasterisers["llvmpipe"][name] for name in RATIOS}, "rasterisers": rasterisers}


def measure_on(
    scene: ClientScene,
    rasteriser: str,
    variants: Mapping[str, Variant],
    plan: Plan,
    out: Path,
    progress: Progress,
    **page_options: Any,
) -> dict[str, Any]:
    """Time variants on one rasteriser; see `measure_client`.

    Args:
        scene: what is drawn, with a packet for every number of slots.
        rasteriser: a key of `RASTERISERS`.
        variants: by name; ratios of those that are missing are left out.
        plan: how much is measured.
        out: existing folder for a picture of every variant.
        progress: called with a line of text before each step.
        page_options: for `open_bench_page`.
    """
    costs: dict[str, list[FrameCost]] = {name: [] for name in variants}
    with open_bench_page(scene, rasteriser, plan.width, plan.height, **page_options) as page:
        vals = _create(page, scene, variants, progress)
        for key in vals:
            (out / f"client_{rasteriser}_{key}.png").write_bytes(page.picture(key))
        for number in range(plan.rounds):
            progress(f"client on {rasteriser}: round {number + 1} of {plan.rounds}")
            for name, variant in variants.items():
                costs[name].append(page.measure(variant.key, variant.kind, plan.frames))
    return {**summarise(costs, RATIOS | EXTRA_RATIOS), "rounds": plan.rounds, "vals": vals}


def _create(
    page: BenchPage, scene: ClientScene, variants: Mapping[str, Variant], progress: Progress
) -> dict[str, int]:
    """Make one context per key; returns the number of VALs that each draws with."""
    vals: dict[str, int] = {}
    for variant in variants.values():
        if variant.key not in vals:
            progress(f"client renderer {variant.key}")
            packet = scene.packets[variant.slots]
            drawn = page.create(variant.key, variant.maker, packet, scene.exposure)
            vals[variant.key] = drawn["vals"]
    return vals


def summarise(
    costs: Mapping[str, Sequence[FrameCost]], ratios: Mapping[str, tuple[str, str]]
) -> dict[str, Any]:
    """Ratios of GPU-process CPU time with their spread, and median costs per variant.

    Args:
        costs: one per round for every variant.
        ratios: name -> numerator and denominator variant; left out where a variant is missing.
    """
    parts = {
        field.name: {name: [getattr(cost, field.name) for cost in rounds] for name, rounds in costs.items()}
        for field in fields(FrameCost)
    }
    wanted = {name: pair for name, pair in ratios.items() if all(side in costs for side in pair)}
    spreads, walls = (
        {
            name: ratio_spread(parts[part][above], parts[part][below])
            for name, (above, below) in wanted.items()
        }
        for part in ("gpu_cpu_ms", "wall_ms")
    )
    return {
        **{name: value.median for name, value in spreads.items()},
        "spread": {name: value.as_dict() for name, value in spreads.items()},
        "wall_ratios": {name: value.median for name, value in walls.items()},
        **{
            "cpu_ms" if part == "gpu_cpu_ms" else part: {name: spread(v).median for name, v in values.items()}
            for part, values in parts.items()
        },
    }


def measure_breakdown(
    scene: ClientScene, rasteriser: str, slots: int, plan: Plan, progress: Progress
) -> dict[str, Any]:
    """Cost of a frame of ours in which one thing changed, also as a share of a full frame of the same round."""
    kinds = ("full", *BREAKDOWN)
    costs: dict[str, list[float]] = {kind: [] for kind in kinds}
    ran: dict[str, list[str]] = {}
    with open_bench_page(scene, rasteriser, plan.width, plan.height) as page:
        page.create("ours", "ours", scene.packets[slots], scene.exposure)
        for number in range(plan.rounds):
            progress(f"breakdown on {rasteriser}: round {number + 1} of {plan.rounds}")
            for kind in kinds:
                costs[kind].append(page.measure("ours", kind, plan.frames).gpu_cpu_ms)
                ran[kind] = [each["name"] for each in page.passes("ours") if each["ran"]]
    return {
        kind: {
            "cpu_ms": spread(costs[kind]).median,
            "over_full": ratio_spread(costs[kind], costs["full"]).median,
            "passes": ran[kind],
        }
        for kind in kinds
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line for work on the renderer: ratios, or the breakdown, on one rasteriser, as JSON."""
    names = list(make_variants(16, 64))
    parser = argparse.ArgumentParser(prog="python -m nearfield_server.benchmark.client_times")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for pictures")
    parser.add_argument("--rasteriser", choices=sorted(RASTERISERS), default="llvmpipe")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=2, help="frames per sample")
    parser.add_argument("--variants", nargs="+", choices=names, default=names, help="default: all")
    parser.add_argument(
        "--breakdown", type=int, metavar="SLOTS", help="cost of single changes with so many slots"
    )
    chosen = parser.parse_args(arguments)
    chosen.out.mkdir(parents=True, exist_ok=True)
    plan = Plan(rounds=chosen.rounds, frames=chosen.frames)
    variants = {name: variant for name, variant in make_variants(16, 64).items() if name in chosen.variants}

    def say(text: str) -> None:
        print(text, file=sys.stderr)  # noqa: T201 - this is the command line

    require_built_page()
    slots = {chosen.breakdown} if chosen.breakdown else {variant.slots for variant in variants.values()}
    scene = client_scene(LAB, sorted(slots), say)
    if chosen.breakdown:
        result = measure_breakdown(scene, chosen.rasteriser, chosen.breakdown, plan, say)
    else:
        result = measure_on(scene, chosen.rasteriser, variants, plan, chosen.out, say)
    print(json.dumps(result, indent=2))  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main())

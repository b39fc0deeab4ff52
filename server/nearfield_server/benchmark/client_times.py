"""What a frame of the client costs next to other renderers: CPU time of Chromium's GPU process, software rasterisers.

Variants take turns within every round, so that the ratios of a round hold on a busy machine; results are medians over rounds.
What each variant draws, and what a full frame is: client_web/bench/variant.ts.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from nearfield_server.benchmark.client_page import RASTERISERS, BenchPage, open_bench_page, require_built_page
from nearfield_server.benchmark.client_scene import ClientScene, lab_scene
from nearfield_server.benchmark.ratios import ratio_spread, spread

WIDTH: Final = 960
HEIGHT: Final = 540
_FRAMES: Final = 3
"""Frames per sample."""
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


VARIANTS: Final = {
    "ours16": Variant(maker="ours", slots=16),
    "ours64": Variant(maker="ours", slots=64),
    "ours_video_only": Variant(maker="ours", slots=16, kind="video"),
    "three16": Variant(maker="three", slots=16),
}
RATIOS: Final = {
    "frame_over_three16": ("ours16", "three16"),
    "vals64_over_vals16": ("ours64", "ours16"),
    "video_only_over_full": ("ours_video_only", "ours16"),
}
BREAKDOWN: Final = ("video", "light colour", "lights moved", "objects moved", "camera")
"""One thing changes per frame: what a frame of ours costs then."""


def measure_client(out: Path, quick: bool, progress: Progress) -> dict[str, Any]:
    """Time all variants on both software rasterisers.

    Args:
        out: existing folder; a picture of every variant is written there.
        quick: fewer rounds, for about two minutes in all.
        progress: called with a line of text before each step.

    Returns:
        The ratios (medians on llvmpipe), and `rasterisers`: per rasteriser the ratios, their `spread`, and cost per variant.

    Raises:
        ServiceError: the page is not built, there is no browser, or the page fails.
    """
    require_built_page()
    scene = lab_scene(tuple(sorted({variant.slots for variant in VARIANTS.values()})), progress)
    rounds = {"llvmpipe": 5 if quick else 15, "swiftshader": 3 if quick else 9}
    rasterisers = {name: measure_on(scene, name, rounds[name], out, progress) for name in RASTERISERS}
    return {**{name: rasterisers["llvmpipe"][name] for name in RATIOS}, "rasterisers": rasterisers}


def measure_on(
    scene: ClientScene, rasteriser: str, rounds: int, out: Path, progress: Progress, *, frames: int = _FRAMES
) -> dict[str, Any]:
    """Time all variants on one rasteriser; see `measure_client`."""
    samples: dict[str, dict[str, list[float]]] = {
        name: {"gpu_cpu_ms": [], "page_cpu_ms": [], "wall_ms": []} for name in VARIANTS
    }
    with open_bench_page(scene, rasteriser, WIDTH, HEIGHT) as page:
        vals = create_variants(page, scene, VARIANTS, progress)
        write_pictures(page, rasteriser, out)
        for number in range(rounds):
            progress(f"client on {rasteriser}: round {number + 1} of {rounds}")
            for name, variant in VARIANTS.items():
                cost = page.measure(variant.key, variant.kind, frames)
                for part, values in samples[name].items():
                    values.append(getattr(cost, part))
    return {**summarise(samples, RATIOS), "rounds": rounds, "vals": vals}


def create_variants(
    page: BenchPage, scene: ClientScene, variants: dict[str, Variant], progress: Progress
) -> dict[str, int]:
    """Make one context per key; returns the number of VALs that each draws with."""
    vals: dict[str, int] = {}
    for variant in variants.values():
        if variant.key not in vals:
            progress(f"compiling {variant.key}")
            packet = scene.packets[variant.slots]
            vals[variant.key] = page.create(variant.key, variant.maker, packet, scene.exposure)
    return vals


def write_pictures(page: BenchPage, rasteriser: str, out: Path) -> None:
    """One PNG per context."""
    for key in dict.fromkeys(variant.key for variant in VARIANTS.values()):
        (out / f"client_{rasteriser}_{key}.png").write_bytes(page.picture(key))


def summarise(
    samples: dict[str, dict[str, list[float]]], ratios: dict[str, tuple[str, str]]
) -> dict[str, Any]:
    """Ratios of GPU-process CPU time with their spread, and median costs per variant.

    Args:
        samples: variant -> part of the cost -> one value per round.
        ratios: name -> numerator and denominator variant.
    """
    spreads = {
        name: ratio_spread(samples[above]["gpu_cpu_ms"], samples[below]["gpu_cpu_ms"])
        for name, (above, below) in ratios.items()
    }
    walls = {
        name: ratio_spread(samples[above]["wall_ms"], samples[below]["wall_ms"]).median
        for name, (above, below) in ratios.items()
    }
    parts = {"cpu_ms": "gpu_cpu_ms", "page_cpu_ms": "page_cpu_ms", "wall_ms": "wall_ms"}
    return {
        **{name: value.median for name, value in spreads.items()},
        "spread": {name: value.as_dict() for name, value in spreads.items()},
        "wall_ratios": walls,
        **{
            key: {name: spread(parts_of[part]).median for name, parts_of in samples.items()}
            for key, part in parts.items()
        },
    }


def measure_breakdown(
    scene: ClientScene, rasteriser: str, slots: int, rounds: int, progress: Progress, *, frames: int = _FRAMES
) -> dict[str, Any]:
    """Cost of a frame of ours in which one thing changed, as a share of a full frame of the same round."""
    kinds = ("full", *BREAKDOWN)
    costs: dict[str, list[float]] = {kind: [] for kind in kinds}
    ran: dict[str, list[str]] = {}
    with open_bench_page(scene, rasteriser, WIDTH, HEIGHT) as page:
        page.create("ours", "ours", scene.packets[slots], scene.exposure)
        for number in range(rounds):
            progress(f"breakdown on {rasteriser}: round {number + 1} of {rounds}")
            for kind in kinds:
                costs[kind].append(page.measure("ours", kind, frames).gpu_cpu_ms)
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
    parser = argparse.ArgumentParser(prog="python -m nearfield_server.benchmark.client_times")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for pictures")
    parser.add_argument("--rasteriser", choices=sorted(RASTERISERS), default="llvmpipe")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--breakdown", type=int, metavar="SLOTS", help="cost of single changes with 16 or 64 VALs"
    )
    chosen = parser.parse_args(arguments)
    chosen.out.mkdir(parents=True, exist_ok=True)

    def say(text: str) -> None:
        print(text, file=sys.stderr)  # noqa: T201 - this is the command line

    require_built_page()
    scene = lab_scene((16, 64), say)
    if chosen.breakdown:
        result = measure_breakdown(
            scene, chosen.rasteriser, chosen.breakdown, chosen.rounds, say, frames=chosen.frames
        )
    else:
        result = measure_on(scene, chosen.rasteriser, chosen.rounds, chosen.out, say, frames=chosen.frames)
    print(json.dumps(result, indent=2))  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main())

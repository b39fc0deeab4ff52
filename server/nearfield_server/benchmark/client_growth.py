"""What a full frame of the client, and the gateway, cost against the size of everything."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any, Final

import numpy as np

from nearfield_protocol.codec import Encoding, decode_light_packet, encode_light_packet
from nearfield_server.benchmark.client_page import BenchPage, open_bench_page, require_built_page
from nearfield_server.benchmark.client_scene import LAB, ClientScene, client_scene
from nearfield_server.benchmark.client_times import Plan, Progress
from nearfield_server.benchmark.ratios import fit_exponent
from nearfield_server.errors import ServiceError
from nearfield_server.gateway.app import create_app
from nearfield_server.gateway.hub import LightHub
from nearfield_server.gateway.ports import NoControls
from nearfield_server.gateway.server import serve_in_thread

_RASTERISER: Final = "llvmpipe"
_VALS: Final = 16
_UPDATE_PERIOD_S: Final = 1.0 / 30.0
_CLIENTS_READY_S: Final = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One form of the scene: slots of its light packet, and changes to the scene (client_web/bench/growth.ts)."""

    slots: int = _VALS
    growth: Mapping[str, int] = field(default_factory=dict)


def measure_client_growth(quick: bool, progress: Progress, *, tiny: bool = False) -> dict[str, Any]:
    """Cost of a full frame of ours on llvmpipe, and of the gateway per light update.

    Args:
        quick: smaller pictures, fewer points and rounds.
        progress: called with a line of text before each step.
        tiny: proves that everything runs; the figures say nothing.

    Returns:
        Per name (`screen_pixels`, `object_triangles`, `vals`, `virtual_objects`, `connected_clients`): `x`, `cpu_ms` and the fitted
        `exponent`. Cost is CPU time: of the browser's GPU process per frame, of the gateway's process per update.

    Raises:
        ServiceError: the page is not built, there is no browser, or the page fails.
    """
    require_built_page()
    slots: tuple[int, ...]
    if tiny:
        plan, slots = Plan(rounds=1, frames=1, width=96, height=54), (2, 4)
    elif quick:
        plan, slots = Plan(rounds=2, frames=1, width=480, height=270), (8, 16, 64)
    else:
        plan, slots = Plan(rounds=5, frames=1), (8, 16, 32, 64)
    scene = client_scene(LAB, sorted({slots[0], *slots}), progress)
    base = _VALS if _VALS in slots else slots[0]
    report = measure_frames(scene, _points(plan, slots, base, short=quick or tiny), plan, progress)
    counts = (1, 2) if tiny else (1, 8, 32) if quick else (1, 5, 10, 25, 50)
    report["connected_clients"] = measure_gateway(scene, base, counts, 15 if tiny else 60, progress)
    return report


def _points(plan: Plan, slots: Sequence[int], base: int, *, short: bool) -> dict[str, dict[int, Point]]:
    """Size -> form of the scene, for every direction of growth."""
    scales = (1, 2) if short else (0.5, 1, 1.5)
    sizes = [(round(plan.width * scale), round(plan.height * scale)) for scale in scales]
    subdivisions = (0, 1) if short else (0, 1, 2)
    objects = (1, 2, 4) if short else (1, 2, 4, 8)
    return {
        "screen_pixels": {
            width * height: Point(slots=base, growth={"width": width, "height": height})
            for width, height in sizes
        },
        # The key becomes the number of triangles when the page knows it.
        "object_triangles": {
            level: Point(slots=base, growth={"subdivisions": level}) for level in subdivisions
        },
        "vals": {number: Point(slots=number) for number in slots},
        "virtual_objects": {number: Point(slots=base, growth={"objects": number}) for number in objects},
    }


def measure_frames(
    scene: ClientScene,
    points: Mapping[str, Mapping[int, Point]],
    plan: Plan,
    progress: Progress,
    **page_options: Any,
) -> dict[str, Any]:
    """Full frames of ours for every point, one browser per direction of growth (a browser holds 16 contexts at most)."""
    return {
        name: _measure_direction(scene, name, forms, plan, progress, page_options)
        for name, forms in points.items()
    }


def _measure_direction(
    scene: ClientScene,
    name: str,
    forms: Mapping[int, Point],
    plan: Plan,
    progress: Progress,
    page_options: Mapping[str, Any],
) -> dict[str, Any]:
    with open_bench_page(scene, _RASTERISER, plan.width, plan.height, **page_options) as page:
        sizes = [_create(page, scene, name, size, form) for size, form in forms.items()]
        costs: list[list[float]] = [[] for _ in forms]
        for number in range(plan.rounds):
            progress(f"growth, {name}: round {number + 1} of {plan.rounds}")
            for values, size in zip(costs, forms, strict=True):
                values.append(page.measure(str(size), "full", plan.frames).gpu_cpu_ms)
    return _curve(sizes, [median(values) for values in costs])


def _create(page: BenchPage, scene: ClientScene, name: str, size: int, form: Point) -> int:
    drawn = page.create(str(size), "ours", scene.packets[form.slots], scene.exposure, growth=form.growth)
    return {"object_triangles": drawn["triangles"], "vals": drawn["vals"]}.get(name, size)


def _curve(sizes: Sequence[int], costs: Sequence[float]) -> dict[str, Any]:
    return {"x": list(sizes), "cpu_ms": list(costs), "exponent": fit_exponent(sizes, costs)}


def measure_gateway(
    scene: ClientScene, slots: int, counts: Sequence[int], updates: int, progress: Progress
) -> dict[str, Any]:
    """CPU time of the gateway per light update, against connected clients that acknowledge every packet.

    The gateway runs in this process, the clients in another one.

    Args:
        scene: its description and packets are used.
        slots: of the light packet.
        counts: numbers of clients.
        updates: light packets per measurement, sent at 30 Hz.
        progress: called with a line of text before each step.

    Raises:
        ServiceError: the clients do not connect.
    """
    packet = decode_light_packet(scene.packets[slots])
    costs = []
    for count in counts:
        progress(f"growth, connected clients: {count}")
        packets = [
            encode_light_packet(
                replace(
                    packet, sequence=number + 1, object_sh=packet.object_sh * np.float32(1 + 1e-3 * number)
                ),
                Encoding.COMPACT,
            )
            for number in range(updates + 1)
        ]
        costs.append(_gateway_cost(scene, packets, count))
    return _curve(counts, costs)


def _gateway_cost(scene: ClientScene, packets: Sequence[bytes], count: int) -> float:
    """Milliseconds of CPU per packet; the first one only starts the clients."""
    hub = LightHub(max_clients=count)
    app = create_app(scene.served.description, hub, NoControls(), assets=scene.served.assets)
    hub.publish_light(packets[0])
    with serve_in_thread(app) as url:
        command = [sys.executable, "-m", "nearfield_server.benchmark.websocket_clients"]
        with subprocess.Popen(
            [*command, url.replace("http", "ws", 1) + "ws", str(count)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as clients:
            try:
                _await_ready(clients, count)
                before = time.process_time()
                for packet in packets[1:]:
                    hub.publish_light(packet)
                    time.sleep(_UPDATE_PERIOD_S)
                return 1e3 * (time.process_time() - before) / (len(packets) - 1)
            finally:
                assert clients.stdin is not None
                clients.stdin.close()
                try:
                    clients.wait(_CLIENTS_READY_S)
                except subprocess.TimeoutExpired:
                    clients.kill()


def _await_ready(clients: subprocess.Popen[str], count: int) -> None:
    assert clients.stdout is not None
    if clients.stdout.readline().strip() != "ready":
        raise ServiceError(
            f"{count} websocket clients of the benchmark ended before they had light; see what they printed above"
        )

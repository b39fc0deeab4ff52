"""Sections of bench.json that other modules measure: what they are given, and which of their figures stand for the section."""

from __future__ import annotations

from typing import Any, Final

from nearfield_server.benchmark.capture_times import measure_capture
from nearfield_server.benchmark.parts import BenchSetup
from nearfield_server.benchmark.scenario import box_scenario, bundle_scenario
from nearfield_server.benchmark.server_growth import measure_server_growth
from nearfield_server.benchmark.server_times import measure
from nearfield_server.benchmark.temporal import measure_temporal
from nearfield_server.errors import ConfigError, ServiceError
from nearfield_server.records import LightSettings

_SERVER_SIZE: Final = 1024
_TINY_SIZE: Final = 48
_TEMPORAL_SIZE: Final = 256
_ROUNDS: Final = 15
_QUICK_ROUNDS: Final = 5


def server_section(setup: BenchSetup) -> dict[str, Any]:
    """The light pipeline at 1024^2 with four cameras of 1024^2, 16 VALs and three objects, also in quick runs.

    That is the box room, whose texels are all seen by every camera; full runs add the rooms of the bundles.
    """
    scenario = box_scenario(_TINY_SIZE if setup.tiny else _SERVER_SIZE)
    settings = LightSettings(num_vals=16, num_samples=256 if setup.tiny else LightSettings().num_samples)
    rounds = 2 if setup.tiny else _QUICK_ROUNDS if setup.quick else _ROUNDS
    section = measure(scenario, settings, setup.backend, rounds)
    if not setup.quick:
        section["rooms"] = [
            measure(bundle_scenario(bundle), settings, setup.backend, rounds) for bundle in setup.bundles
        ]
    return section


def capture_section(setup: BenchSetup) -> dict[str, Any]:
    """Developing, merging, cleaning and recording a picture of the first bundle."""
    if not setup.bundles:
        raise ConfigError("capture: expected a bundle with simulated cameras, found none; leave out --no-lab")
    return measure_capture(setup.bundles[0], 2 if setup.tiny else _QUICK_ROUNDS if setup.quick else _ROUNDS)


def client_section(setup: BenchSetup) -> dict[str, Any]:
    """Frames of the client next to three.js and PlayCanvas; pictures of all of them go to the folder `client`."""
    # Brings the browser's libraries; the other sections do without.
    from nearfield_server.benchmark.client_times import measure_client

    pictures = setup.out / "client"
    pictures.mkdir(parents=True, exist_ok=True)
    return measure_client(pictures, setup.quick, setup.say, tiny=setup.tiny)


def ablation_section(setup: BenchSetup) -> list[dict[str, Any]]:
    """Errors, bytes and time with one ingredient left out after the other; pictures are judged in full runs only."""
    # Brings the browser's libraries; the other sections do without.
    from nearfield_server.benchmark.ablation import measure_ablation

    rows: list[dict[str, Any]] = []
    for bundle in setup.bundles:
        setup.say(f"  bundle {bundle.name}")
        rows += measure_ablation(bundle, setup.quick, setup.say, with_views=not setup.quick)
    return rows


def growth_section(setup: BenchSetup) -> dict[str, Any]:
    """Cost against the size of everything."""
    # Brings the browser's libraries; the other sections do without.
    from nearfield_server.benchmark.client_growth import measure_client_growth

    server = measure_server_growth(setup.backend, setup.quick, setup.say, tiny=setup.tiny)
    try:
        return server | measure_client_growth(setup.quick, setup.say, tiny=setup.tiny)
    except ServiceError as error:
        return server | {"missing": str(error)}


def temporal_section(setup: BenchSetup) -> dict[str, Any]:
    """Noise, switched and dimmed lamps in the box room; in full runs in the bundles' rooms as well."""
    size = _TINY_SIZE if setup.tiny else _TEMPORAL_SIZE
    rooms = [measure_temporal(box_scenario(size), setup.quick)]
    if not setup.quick:
        rooms += [measure_temporal(bundle_scenario(bundle), quick=False) for bundle in setup.bundles]
    return {"rooms": rooms}


def latency_section(setup: BenchSetup) -> dict[str, Any]:
    """From a captured frame to the packet sent, and to the pixel."""
    # Brings websockets and the browser's libraries.
    from nearfield_server.benchmark.latency import measure_latency

    return measure_latency(setup.quick or setup.tiny, setup.say)

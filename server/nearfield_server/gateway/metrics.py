"""Numbers for Prometheus."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.platform_collector import PlatformCollector
from prometheus_client.process_collector import ProcessCollector
from prometheus_client.registry import Collector

from nearfield_server.gateway.camera_metrics import CameraCollector

CONTENT_TYPE = CONTENT_TYPE_LATEST


class GatewayMetrics:
    """Counters of one gateway, in a registry of their own so that several can live in one process."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        PlatformCollector(registry=self.registry)
        self.clients = Gauge("nearfield_clients", "Connected clients.", registry=self.registry)
        self.light_packets = Counter(
            "nearfield_light_packets", "Light packets taken from the bus.", registry=self.registry
        )
        self.light_replaced = Counter(
            "nearfield_light_replaced",
            "Light packets that were replaced by newer ones before a client was ready for them.",
            registry=self.registry,
        )
        self.light_age = Gauge(
            "nearfield_light_age_seconds",
            "Age of the newest light.",
            registry=self.registry,
        )
        self.sent_messages = Counter(
            "nearfield_sent_messages", "Messages sent to clients.", registry=self.registry
        )
        self.sent_bytes = Counter("nearfield_sent_bytes", "Bytes of those messages.", registry=self.registry)
        self.control_requests = Counter(
            "nearfield_control_requests", "Requests from clients to change something.", registry=self.registry
        )
        self.closed = Counter(
            "nearfield_closed_connections",
            "Connections that the server closed.",
            ["code"],
            registry=self.registry,
        )
        self.refused = Counter(
            "nearfield_refused_requests", "Requests refused for their host or origin.", registry=self.registry
        )

    def watch_stages(self, statuses: Callable[[], dict[str, Any]]) -> None:
        """Add what the light stages did, read from the newest statuses of all processes whenever somebody asks."""
        self.registry.register(_StageCollector(statuses))

    def watch_cameras(self, statuses: Callable[[], dict[str, Any]]) -> None:
        """Add what is known of each camera and of the processes, likewise."""
        self.registry.register(CameraCollector(statuses))

    def render(self) -> bytes:
        """The numbers in Prometheus' text format."""
        return generate_latest(self.registry)


class _StageCollector(Collector):
    """The account of the light stages (`illumination.work_ledger`) as samples; nothing is kept in between."""

    def __init__(self, statuses: Callable[[], dict[str, Any]]) -> None:
        self._statuses = statuses

    def describe(self) -> Iterable[Metric]:
        """No names beforehand: there are no stages before the first update."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Samples of the newest status."""
        status = self._statuses().get("illumination", {})
        updates = CounterMetricFamily(
            "nearfield_stage_updates",
            "Updates of the light in which a stage ran in full, ran in part or was skipped.",
            labels=("stage", "outcome"),
        )
        spent = CounterMetricFamily(
            "nearfield_stage_cpu_seconds", "CPU time of a light stage.", labels=("stage",)
        )
        saved = CounterMetricFamily(
            "nearfield_stage_saved_cpu_seconds", "CPU time that skipping saved, estimated.", labels=("stage",)
        )
        bound = GaugeMetricFamily(
            "nearfield_skipping_error_bound",
            "Largest relative error of the light that skipping can have caused.",
        )
        for stage in status.get("stages", ()):
            for outcome in ("full", "part", "skipped"):
                updates.add_metric((stage["name"], outcome), stage[f"updates_{outcome}"])
            spent.add_metric((stage["name"],), stage["spent_total_ms"] * 1e-3)
            saved.add_metric((stage["name"],), stage["saved_total_ms"] * 1e-3)
        if "skipping" in status:
            bound.add_metric((), status["skipping"]["error_bound"])
        return updates, spent, saved, bound

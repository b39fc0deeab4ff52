"""Numbers for Prometheus."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, Counter, Gauge, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.platform_collector import PlatformCollector
from prometheus_client.process_collector import ProcessCollector

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

    def render(self) -> bytes:
        """The numbers in Prometheus' text format."""
        return generate_latest(self.registry)

"""What Prometheus is told about cameras, processes and a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from nearfield_server.gateway.camera_summary import LIVE, LOST, STALE, STARTING, summarise_cameras

# Field of the summary, name, help.
_COUNTERS: Final = (
    ("frames", "nearfield_camera_frames", "Pictures that a camera delivered since its process started."),
    ("frames_lost", "nearfield_camera_frames_lost", "Pictures that the camera took and that never arrived."),
    (
        "frames_broken",
        "nearfield_camera_frames_broken",
        "Pictures that arrived with holes and were not used.",
    ),
    (
        "frames_skipped",
        "nearfield_camera_frames_skipped",
        "Pictures that were replaced by newer ones unused.",
    ),
    ("reconnects", "nearfield_camera_reconnects", "How often the camera was opened again after a fault."),
    ("restarts", "nearfield_camera_restarts", "How often the process of the camera was started again."),
)
_GAUGES: Final = (
    ("frame_rate", "nearfield_camera_frame_rate_hertz", "Pictures per second, measured."),
    ("age_s", "nearfield_camera_age_seconds", "Age of the newest picture that the light uses."),
    (
        "saturated_share",
        "nearfield_camera_saturated_ratio",
        "Share of pixels that are saturated in every exposure.",
    ),
    ("temperature_c", "nearfield_camera_temperature_celsius", "Temperature of the camera."),
    ("gain", "nearfield_camera_gain_ratio", "Gain as a linear factor."),
)
_STATES: Final = (LIVE, STALE, LOST, STARTING)


class CameraCollector(Collector):
    """Reads the newest statuses of all processes whenever somebody asks; nothing is kept in between."""

    def __init__(self, statuses: Callable[[], dict[str, Any]]) -> None:
        self._statuses = statuses

    def describe(self) -> Iterable[Metric]:
        """No names beforehand: there are no cameras before their processes speak."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Samples of the newest statuses."""
        statuses = self._statuses()
        cameras = summarise_cameras(statuses)
        families: list[CounterMetricFamily | GaugeMetricFamily] = []
        for field, name, text in _COUNTERS:
            counter = CounterMetricFamily(name, text, labels=("camera",))
            families.append(_filled(counter, cameras, field))
        for field, name, text in _GAUGES:
            gauge = GaugeMetricFamily(name, text, labels=("camera",))
            families.append(_filled(gauge, cameras, field))
        exposure = GaugeMetricFamily(
            "nearfield_camera_exposure_seconds", "Exposure times of a picture.", labels=("camera", "exposure")
        )
        state = GaugeMetricFamily(
            "nearfield_camera_state", "1 for the state that the camera is in.", labels=("camera", "state")
        )
        for camera in cameras:
            for index, time_s in enumerate(camera["exposure_s"]):
                exposure.add_metric((camera["id"], str(index)), time_s)
            for name in _STATES:
                state.add_metric((camera["id"], name), float(camera["state"] == name))
        restarts = CounterMetricFamily(
            "nearfield_process_restarts", "How often a process was started again.", labels=("process",)
        )
        for name, child in (statuses.get("supervisor", {}).get("children") or {}).items():
            restarts.add_metric((name,), child.get("restarts", 0))
        return [*families, exposure, state, restarts, *_recording_families(statuses.get("recorder", {}))]


def _recording_families(recorder: dict[str, Any]) -> Iterable[Metric]:
    """Frames of the recording that runs or ran last."""
    for field, text in (
        ("frames_written", "Frames that the recording holds."),
        ("frames_dropped", "Frames that the machine was too slow to record."),
    ):
        if isinstance(recorder.get(field), int):
            yield CounterMetricFamily(f"nearfield_recording_{field}", text, value=recorder[field])


def _filled(
    family: CounterMetricFamily | GaugeMetricFamily, cameras: list[dict[str, Any]], field: str
) -> CounterMetricFamily | GaugeMetricFamily:
    for camera in cameras:
        if camera[field] is not None:
            family.add_metric((camera["id"],), camera[field])
    return family

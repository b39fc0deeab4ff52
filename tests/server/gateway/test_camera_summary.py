"""What a person is told of each camera: from statuses to words, charts and Prometheus."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client.parser import text_string_to_metric_families

from nearfield_server.gateway.camera_summary import summarise_cameras
from nearfield_server.gateway.history import LENGTH, StatusHistory
from nearfield_server.gateway.metrics import GatewayMetrics


def camera(index: int, **changes: Any) -> dict[str, Any]:
    status = {
        "camera_index": index,
        "camera_id": f"ceiling{index}",
        "phase": "running",
        "status_age_s": 0.2,
        "connected": True,
        "fault": "",
        "frames": 100,
        "frame_rate": 10.0,
        "counters": {"lower_bound": 7},
        "source": {
            "kind": "aravis",
            "frames_lost": 2,
            "frames_broken": 1,
            "exposure_s": [0.01, 0.001],
            "saturated_share": 0.25,
        },
    }
    return {**status, **changes}


def statuses(**cameras: dict[str, Any]) -> dict[str, dict[str, Any]]:
    ages = [
        {"camera_id": entry["camera_id"], "age_s": 0.05, "stale": False}
        for entry in cameras.values()
        if isinstance(entry.get("camera_id"), str)
    ]
    children = {name: {"pid": 100, "restarts": 0, "last_fault": ""} for name in cameras}
    return {
        **cameras,
        "illumination": {"cameras": ages, "light_age_s": 0.05, "updates": 12},
        "supervisor": {"children": children},
    }


def test_cameras_come_in_the_order_of_the_room_and_other_processes_are_none() -> None:
    found = summarise_cameras(statuses(cam1=camera(1), cam0=camera(0)))
    assert [entry["id"] for entry in found] == ["ceiling0", "ceiling1"]
    assert found[0]["state"] == "live"
    assert (found[0]["age_s"], found[0]["frames_lost"], found[0]["exposure_s"]) == (0.05, 2, [0.01, 0.001])
    assert found[0]["temperature_c"] is None


def test_a_fault_is_told_in_the_words_of_the_camera() -> None:
    [lost] = summarise_cameras(statuses(cam0=camera(0, connected=False, fault="no frame for 0.6 s")))
    assert (lost["state"], lost["fault"]) == ("lost", "no frame for 0.6 s")


def test_old_pictures_silent_and_dead_processes_are_told_apart() -> None:
    old = statuses(cam0=camera(0))
    old["illumination"]["cameras"][0]["stale"] = True
    assert summarise_cameras(old)[0]["state"] == "stale"
    [silent] = summarise_cameras(statuses(cam0=camera(0, status_age_s=8.0)))
    assert (silent["state"], silent["fault"]) == ("lost", "its process has said nothing for 8 s")
    dead = statuses(cam0=camera(0))
    dead["supervisor"]["children"]["cam0"] = {"pid": None, "restarts": 3, "last_fault": "killed by SIGKILL"}
    assert summarise_cameras(dead)[0]["state"] == "lost"
    assert "killed by SIGKILL" in summarise_cameras(dead)[0]["fault"]
    [starting] = summarise_cameras(statuses(cam0=camera(0, phase="starting", connected=False)))
    assert starting["state"] == "starting"


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
fields = st.sampled_from(
    ["camera_id", "source", "counters", "fault", "connected", "frame_rate", "status_age_s"]
)


@given(changes=st.dictionaries(fields, json_values, max_size=4))
def test_whatever_a_process_says_the_summary_is_json_and_names_the_camera(changes: dict[str, Any]) -> None:
    [entry] = summarise_cameras(statuses(cam0=camera(0, **changes)))
    assert entry["process"] == "cam0"
    assert json.loads(json.dumps(entry, allow_nan=False)) == entry


def test_history_keeps_the_last_minutes_and_says_how_old_they_are() -> None:
    history = StatusHistory()
    for second in range(LENGTH + 20):
        status = statuses(cam0=camera(0, source={"frames_lost": second}))
        history.sample(float(second), status, num_clients=2)
        history.sample(second + 0.4, status, num_clients=2)  # too early: not a second one
    columns = history.as_json(LENGTH + 20.0)
    assert columns["ago_s"] == [float(ago) for ago in range(LENGTH, 0, -1)]
    assert columns["cameras"]["ceiling0"]["frames_lost"] == list(range(20, LENGTH + 20))
    assert columns["light"]["clients"] == [2] * LENGTH
    json.dumps(columns, allow_nan=False)


def test_a_camera_that_comes_later_has_nothing_before() -> None:
    history = StatusHistory()
    history.sample(0.0, statuses(cam0=camera(0)), 0)
    history.sample(1.0, statuses(cam0=camera(0), cam1=camera(1)), 0)
    cameras = history.as_json(1.0)["cameras"]
    assert cameras["ceiling1"]["frame_rate"] == [None, 10.0]
    assert cameras["ceiling0"]["frame_rate"] == [10.0, 10.0]


def test_prometheus_is_told_what_is_known_and_nothing_else() -> None:
    metrics = GatewayMetrics()
    metrics.watch_cameras(lambda: statuses(cam0=camera(0, source={"exposure_s": [0.02]})))
    found = {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(metrics.render().decode())
        for sample in family.samples
        if sample.name.startswith(("nearfield_camera", "nearfield_process"))
    }
    assert found == pytest.approx(
        {
            ("nearfield_camera_frames_total", "ceiling0"): 100,
            ("nearfield_camera_restarts_total", "ceiling0"): 0,
            ("nearfield_camera_frame_rate_hertz", "ceiling0"): 10.0,
            ("nearfield_camera_age_seconds", "ceiling0"): 0.05,
            ("nearfield_camera_exposure_seconds", "0", "ceiling0"): 0.02,
            ("nearfield_camera_state", "ceiling0", "live"): 1.0,
            ("nearfield_camera_state", "ceiling0", "stale"): 0.0,
            ("nearfield_camera_state", "ceiling0", "lost"): 0.0,
            ("nearfield_camera_state", "ceiling0", "starting"): 0.0,
            ("nearfield_process_restarts_total", "cam0"): 0,
        }
    )

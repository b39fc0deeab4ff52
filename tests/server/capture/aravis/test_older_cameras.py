"""A camera that is not on the network and has the older names of features: libaravis's own device without hardware, in this process."""

import pytest

from nearfield_server.capture.aravis import device
from nearfield_server.capture.aravis.connection import Connection
from nearfield_server.capture.aravis.device import AravisDevice
from nearfield_server.capture.aravis.gvcp import FoundCamera
from nearfield_server.capture.aravis.library import Aravis
from nearfield_server.capture.device import Exposure
from nearfield_server.errors import CaptureError
from nearfield_server.scene.device_schema import AravisSourceTable

WIDTH, HEIGHT = 64, 32


def connect_without_hardware(aravis: Aravis, table: AravisSourceTable, where: str) -> Connection:
    handle = aravis.c.arv_fake_device_new(str(table.serial).encode())
    assert handle is not None
    camera = FoundCamera(
        kind="usb3",
        address="",
        mac="",
        vendor="Aravis",
        model="Fake",
        serial=str(table.serial),
        user_name="",
        interface="/dev/bus/usb/002/007",
        is_reachable=True,
    )
    return Connection(device=handle, camera=camera, names=frozenset(), ticks_per_s=10**9, is_controller=True)


def make(monkeypatch: pytest.MonkeyPatch, **keys: object) -> AravisDevice:
    monkeypatch.setattr(device, "connect", connect_without_hardware)
    table = AravisSourceTable.model_validate(
        {"kind": "aravis", "serial": "U1", "pixel_format": "Mono16", "region": (0, 0, WIDTH, HEIGHT), **keys}
    )
    return AravisDevice("fish-0", table, WIDTH, HEIGHT, 50.0)


def test_pictures_and_exposures(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = make(monkeypatch, exposure_s=0.005, features={"GainRaw": 3})
    capabilities = opened.open()
    assert capabilities.exposure_range_s == pytest.approx((1e-5, 10.0))  # ExposureTimeAbs
    assert capabilities.gain_range == (1.0, 1.0)  # GainRaw has no known unit
    assert not capabilities.labels_exposure
    numbers = []
    for _ in range(3):
        frame = opened.next_frame(20.0)
        assert frame is not None
        assert (frame.data.size, frame.exposure) == (2 * WIDTH * HEIGHT, Exposure(time_s=0.005))
        numbers.append(frame.frame_id)
        opened.release(frame)
    assert numbers == [1, 2, 3]
    assert opened.set_exposure(Exposure(time_s=0.002)).time_s == pytest.approx(0.002)
    statistics = opened.statistics()
    assert (statistics["transport"], statistics["path"]) == ("usb3", "/dev/bus/usb/002/007")
    assert not {"address", "packet_size", "packets_resent"} & statistics.keys()
    opened.close()


def test_a_gain_of_unknown_unit_cannot_be_set_in_decibels(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        CaptureError, match=r"serial U1\) has no gain in decibels; expected gain_db = 0, found 6\.0"
    ):
        make(monkeypatch, gain_db=6.0).open()


def test_a_device_that_is_not_open_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = make(monkeypatch)
    for use in (closed.trigger, closed.read_exposure, lambda: closed.next_frame(0.0)):
        with pytest.raises(CaptureError, match="is not open"):
            use()
    closed.close()
    assert closed.statistics()["frames_received"] == 0

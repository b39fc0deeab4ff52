"""Devices for connected cameras, and codes as shares of the signal range."""

from __future__ import annotations

import numpy as np
import pytest

from nearfield_server.capture.aravis.device import AravisDevice
from nearfield_server.capture.device import Exposure, SensorFrame
from nearfield_server.capture.v4l2.device import V4l2Device
from nearfield_server.errors import ConfigError
from nearfield_server.onboarding.connected import Connected
from nearfield_server.onboarding.opening import SignalDecoder, open_camera
from nearfield_server.onboarding.source_plan import source_table


def test_every_kind_has_its_device() -> None:
    gige = Connected(kind="gige", place="192.168.10.21", width=64, height=48, pixel_formats=("Mono8",))
    assert isinstance(open_camera(gige, source_table(gige, "Mono8"))[0](), AravisDevice)
    video = Connected(
        kind="v4l2", place="/dev/video0", pixel_formats=("MJPEG", "YUYV"), format_sizes=((64, 48), (0, 0))
    )
    assert isinstance(open_camera(video, source_table(video, "MJPEG"))[0](), V4l2Device)
    with pytest.raises(ConfigError, match="does not tell the size"):
        open_camera(video, source_table(video, "YUYV"))


@pytest.mark.parametrize("exposure_s", [1e-4, 0.1])
def test_the_signal_does_not_depend_on_what_the_exposure_was(exposure_s: float) -> None:
    """Codes of 12 bits, unpacked: 0 is black, 98 % of 4095 and more is saturated, between them the signal is code / 4095."""
    camera = Connected(kind="gige", place="192.168.10.21", pixel_formats=("Mono12",))
    codes = np.tile(np.array([[0, 1000, 2047, 4095]], "<u2"), (8, 4))
    decoder = SignalDecoder(source_table(camera, "Mono12"))
    for _ in range(2):
        signal = decoder(
            SensorFrame(
                data=codes.view(np.uint8).ravel(),
                pixel_format="Mono12",
                width=16,
                height=8,
                row_bytes=32,
                frame_id=1,
                device_ns=None,
                arrival_ns=0,
                exposure=Exposure(time_s=exposure_s),
            )
        )
    assert signal.shape == (8, 16, 4)
    np.testing.assert_allclose(signal[3, :3, 1], codes[3, :3] / 4095, atol=1e-3)
    assert (signal[..., 3] == 1.0).tolist() == (codes < 4095).tolist()
    assert ((signal[codes == 4095][:, 3] > 0.5) & (signal[codes == 4095][:, 3] < 1.0)).all()

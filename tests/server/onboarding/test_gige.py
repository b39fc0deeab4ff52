"""Only one machine is ever asked."""

from __future__ import annotations

import pytest

from nearfield_server.errors import CaptureError
from nearfield_server.onboarding.gige import ask_camera


@pytest.mark.parametrize("address", ["255.255.255.255", "224.0.0.1", "0.0.0.0", "camera.local", "::1", ""])
def test_only_addresses_of_one_machine_are_asked(address: str) -> None:
    with pytest.raises(CaptureError, match="expected"):
        ask_camera(address)


def test_broadcast_addresses_of_networks_are_refused_by_the_kernel() -> None:
    with pytest.raises(CaptureError, match=r"no way to the camera at 127\.255\.255\.255"):
        ask_camera("127.255.255.255")

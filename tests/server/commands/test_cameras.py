"""`nearfield cameras` with a finder that is made up."""

from __future__ import annotations

import json
from collections.abc import Sequence

import pytest
import typer
from typer.testing import CliRunner

from nearfield_server.commands import cameras as command
from nearfield_server.onboarding.connected import Connected, Details


class FakeFinder:
    asked: tuple[str, ...] = ()

    def on_interface(self, interface: str) -> Sequence[Connected]:
        FakeFinder.asked += (interface,)
        return [Connected(kind="gige", place="192.168.10.21", vendor="Maker", model="Eye")]

    def at_address(self, address: str) -> Connected:
        FakeFinder.asked += (address,)
        return Connected(kind="gige", place=address)

    def on_usb(self) -> Sequence[Connected]:
        return []

    def video(self) -> Sequence[Connected]:
        return []

    def details(self, camera: Connected) -> Details:
        return Details(width=1024, height=768, pixel_formats=("BayerRG12p",))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(command, "ThisMachinesFinder", FakeFinder)
    monkeypatch.setattr(FakeFinder, "asked", ())
    app = typer.Typer()
    app.command()(command.cameras)
    return lambda *arguments: CliRunner().invoke(app, list(arguments))


def test_nothing_is_asked_without_being_named(run) -> None:
    result = run()
    assert result.exit_code == 0
    assert FakeFinder.asked == ()
    assert "No camera found." in result.stdout
    assert "--interface enp3s0" in result.stdout


def test_named_interfaces_and_addresses(run) -> None:
    result = run("--interface", "enp3s0", "--interface", "enp4s0", "--address", "10.0.0.5")
    assert FakeFinder.asked == ("enp3s0", "enp4s0", "10.0.0.5")
    assert "Maker Eye" in result.stdout
    assert "1024 x 768" in result.stdout
    assert "--interface enp3s0" not in result.stdout
    told = json.loads(run("--address", "10.0.0.5", "--json").stdout)
    assert told["cameras"][0]["place"] == "10.0.0.5"
    assert told["cameras"][0]["pixel_formats"] == ["BayerRG12p"]

"""A command group that imports a command only when it runs: `nearfield --help` needs no numba, zenoh or graphics."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

from nearfield_server.errors import ConfigError


@dataclass(frozen=True, slots=True)
class CommandEntry:
    """Where a command lives: `attribute` of `module` is a function with typer annotations, or a `typer.Typer`."""

    module: str
    attribute: str
    summary: str


COMMANDS: dict[str, CommandEntry] = {
    "demo": CommandEntry(
        "nearfield_server.commands.demo", "demo", "Serve the room that comes with Nearfield."
    ),
    "serve": CommandEntry(
        "nearfield_server.commands.serve", "serve", "Serve a room: cameras in, light and page out."
    ),
    "cameras": CommandEntry(
        "nearfield_server.commands.cameras", "cameras", "List connected cameras and write a room file."
    ),
    "doctor": CommandEntry(
        "nearfield_server.commands.doctor", "doctor", "Check this machine and say what to do."
    ),
    "capture": CommandEntry(
        "nearfield_server.commands.capture", "capture", "Send this machine's cameras to a service on another."
    ),
    "certificates": CommandEntry(
        "nearfield_server.commands.certificates", "app", "Say which machines may join a room."
    ),
    "record": CommandEntry(
        "nearfield_server.commands.record", "record", "Record what the cameras of a room see."
    ),
    "replay": CommandEntry(
        "nearfield_server.commands.replay",
        "replay",
        "Serve a recording again, or check that it gives the same light.",
    ),
    "recording": CommandEntry(
        "nearfield_server.commands.recording", "app", "Look at recordings, verify and export them."
    ),
    "prepare": CommandEntry(
        "nearfield_server.commands.prepare", "prepare", "Prepare a virtual object for lighting."
    ),
    "evaluate": CommandEntry(
        "nearfield_server.commands.evaluate",
        "evaluate",
        "Compare a bundle's truth with what Nearfield shows.",
    ),
    "bench": CommandEntry(
        "nearfield_server.commands.bench", "bench", "Measure run time against error of every method."
    ),
    "compare": CommandEntry(
        "nearfield_server.commands.compare", "compare", "Put two benchmark runs side by side."
    ),
    "lab": CommandEntry(
        "nearfield_server.virtual_lab.cli", "app", "Make path-traced rooms with known truth."
    ),
}


def load_command(name: str) -> Any:
    """Import a command and return it as a click command.

    Raises:
        ConfigError: the command needs a package that is not installed.
    """
    entry = COMMANDS[name]
    try:
        target = getattr(importlib.import_module(entry.module), entry.attribute)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"command '{name}' needs the Python module '{error.name}', which is not installed; "
            "install Nearfield with the extra it belongs to, such as nearfield[lab] or nearfield[evaluate]"
        ) from error
    if isinstance(target, typer.Typer):
        return typer.main.get_command(target)
    single = typer.Typer(add_completion=False)
    single.command(name)(target)
    return typer.main.get_command(single)


class LazyGroup(TyperGroup):
    """Lists `COMMANDS` from their summaries and loads the one that is called."""

    entries: ClassVar[dict[str, CommandEntry]] = COMMANDS

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of the table."""
        return list(self.entries)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a stand-in for lists of commands."""
        if cmd_name not in self.entries:
            return None
        return TyperCommand(name=cmd_name, help=self.entries[cmd_name].summary)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Return the command that is about to run, imported."""
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None and command.name is not None and command.name in self.entries:
            return name, load_command(command.name), rest
        return name, command, rest

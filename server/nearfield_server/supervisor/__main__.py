"""The supervisor process: `python -m nearfield_server.supervisor`, started by the launcher with the settings on standard input."""

from __future__ import annotations

import faulthandler
import signal
import sys

from nearfield_server.bus.worker import configure_logging, die_with_parent, set_on_signals
from nearfield_server.errors import ConfigError, NearfieldError
from nearfield_server.scene.room_config import RoomConfig, load_room
from nearfield_server.supervisor.settings import ServiceSettings
from nearfield_server.supervisor.supervisor import PROCESS_NAME, Supervisor

EXIT_CONFIG = 2
EXIT_SERVICE = 3


def _check_timeline(room: RoomConfig, name: str | None) -> None:
    """Refuse a wrong name here, once, and not in every camera again and again.

    Raises:
        ConfigError: the room has no such lighting sequence.
    """
    if name is not None:
        from nearfield_server.capture.cameras import (
            load_timeline,  # loads numba; most services need no timeline
        )

        load_timeline(room, name)


def _check_remote(room: RoomConfig) -> None:
    """Refuse certificates that no node would accept, before anything is started.

    Raises:
        ConfigError: says which file and why.
    """
    if room.remote_nodes:
        from nearfield_server.capture.remote.gate import check_service_certificate

        check_service_certificate(room)


def main() -> int:
    """Run the service until a signal ends it; deliberate errors become one line on standard error."""
    faulthandler.enable()
    try:
        settings = ServiceSettings.from_json(sys.stdin.readline())
        configure_logging(PROCESS_NAME)
        # SIGTERM: if the launcher is killed, the service still ends cleanly.
        die_with_parent(settings.launcher_pid, signal.SIGTERM)
        room = load_room(settings.room_path)
        _check_timeline(room, settings.timeline)
        _check_remote(room)
        supervisor = Supervisor(settings, room)
    except NearfieldError as error:
        sys.stderr.write(f"nearfield: {error}\n")
        return EXIT_CONFIG if isinstance(error, ConfigError) else EXIT_SERVICE
    set_on_signals(supervisor.stop)
    try:
        supervisor.start()
        supervisor.run()
    except NearfieldError as error:
        sys.stderr.write(f"nearfield: {error}\n")
        return EXIT_SERVICE
    finally:
        supervisor.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())

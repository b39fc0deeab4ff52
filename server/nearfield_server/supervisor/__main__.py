"""The supervisor process: `python -m nearfield_server.supervisor`, started by the launcher with the settings on standard input."""

from __future__ import annotations

import faulthandler
import signal
import sys

from nearfield_server.bus.worker import configure_logging, die_with_parent, set_on_signals
from nearfield_server.errors import ConfigError, NearfieldError
from nearfield_server.scene.room_config import load_room
from nearfield_server.supervisor.settings import ServiceSettings
from nearfield_server.supervisor.supervisor import PROCESS_NAME, Supervisor

EXIT_CONFIG = 2
EXIT_SERVICE = 3


def main() -> int:
    """Run the service until a signal ends it; deliberate errors become one line on standard error."""
    faulthandler.enable()
    try:
        settings = ServiceSettings.from_json(sys.stdin.readline())
        configure_logging(PROCESS_NAME)
        # SIGTERM: if the launcher is killed, the service still ends cleanly.
        die_with_parent(settings.launcher_pid, signal.SIGTERM)
        supervisor = Supervisor(settings, load_room(settings.room_path))
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

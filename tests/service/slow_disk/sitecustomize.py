"""A slow disk: found by Python as it starts, if this folder is on PYTHONPATH.

In a recorder, and nowhere else, every write of a segment first waits as many seconds as the file named by NEARFIELD_TESTS_SLOW_DISK says.
"""

import os
import sys
import time
from pathlib import Path

if "nearfield_server.recording.process" in sys.orig_argv and "NEARFIELD_TESTS_SLOW_DISK" in os.environ:
    from nearfield_server.recording.files import raw_store

    _delay = Path(os.environ["NEARFIELD_TESTS_SLOW_DISK"])
    _write = raw_store._AllOrNothing.write

    def _write_slowly(self, data):
        if _delay.is_file():
            time.sleep(float(_delay.read_text()))
        return _write(self, data)

    raw_store._AllOrNothing.write = _write_slowly

"""Freed pictures stay with the process: packing the next one costs no page faults."""

from __future__ import annotations

import subprocess
import sys

import pytest

_PROGRAM = """
import resource, sys, threading
import numpy as np
from nearfield_server.recording.files.packed_picture import pack_picture
from nearfield_server.recording.heap import keep_freed_memory

def count():
    pack_picture(pixels)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        pack_picture(pixels)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)

pixels = np.random.default_rng(1).random((1024, 1024, 4)).astype(np.float16)
if sys.argv[1] == "kept" and not keep_freed_memory():
    sys.exit(3)
writer = threading.Thread(target=count)
writer.start()
writer.join()
"""


def _faults_per_picture(mode: str) -> float:
    run = subprocess.run([sys.executable, "-c", _PROGRAM, mode], capture_output=True, check=False)
    if run.returncode == 3:
        pytest.skip("the C library of this machine has no such setting")
    assert run.returncode == 0, run.stderr.decode()
    return int(run.stdout) / 20


def test_pictures_packed_one_after_the_other_cost_no_page_faults() -> None:
    kept, given_back = _faults_per_picture("kept"), _faults_per_picture("given back")
    assert kept < 0.05 * given_back
    assert given_back > 500

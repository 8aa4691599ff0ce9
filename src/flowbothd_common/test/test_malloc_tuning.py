"""Freed memory stays with the process, so that the next frame finds it."""

import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
from flowbothd_common.malloc_tuning import keep_freed_memory

if "keep" in sys.argv and not keep_freed_memory():
    sys.exit(3)
def frame():
    # Two that live at once: as soon as a frame is freed the next one is on its way.
    a = bytearray(6_000_000)
    b = bytes(a)
for _ in range(3):
    frame()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    frame()
print((resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) / 20)
"""


def faults_a_frame(*arguments):
    command = [sys.executable, "-c", FAULTS, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    if done.returncode == 3:
        pytest.skip("this C library has no mallopt")
    assert done.returncode == 0, done.stderr
    return float(done.stdout)


def test_frames_find_the_memory_of_those_before_them():
    """A cloud at 30 Hz cost 4300 page faults each, a third of the time of perception_node."""
    pytest.importorskip("resource", reason="page faults are counted on Unix only")
    assert faults_a_frame("keep") < 10


def test_what_stays_is_not_looked_through_again():
    import gc

    from flowbothd_common.malloc_tuning import spare_what_stays

    before = gc.get_freeze_count()
    try:
        spare_what_stays()
        assert gc.get_freeze_count() > before + 1000
    finally:
        gc.unfreeze()

"""Allocator and garbage collector settings for nodes that handle messages of megabytes."""

from __future__ import annotations

import ctypes
import gc

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Names of the settings in mallopt(3)."""

_MMAP_THRESHOLD_BYTES = 32 << 20
"""Size from which glibc maps a block by itself: the largest value that mallopt accepts."""

_KEPT_BYTES = 256 << 20
"""Freed memory that the process keeps: some forty clouds of 6 MB."""


def keep_freed_memory() -> bool:
    """Have this process keep the memory that it frees, up to 256 MB.

    By default glibc gives a camera's frame back to the system as soon as it is freed, and fetches
    the next one's page by page: more than 4000 page faults for a cloud of 6 MB, which cost as much
    as everything that is done with its points.

    Returns:
        True if the C library accepts the settings; without them everything still works, slower.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    settings = ((_MMAP_THRESHOLD, _MMAP_THRESHOLD_BYTES), (_TRIM_THRESHOLD, _KEPT_BYTES))
    return all(mallopt(name, value) == 1 for name, value in settings)


def spare_what_stays() -> None:
    """Leave what lives now out of further garbage collections.

    Modules and what a node has set up stay until its end; looking through them takes a tenth of a
    second, in which frames wait.
    """
    gc.collect()
    gc.freeze()


def free_what_stayed() -> None:
    """Undo `spare_what_stays` and collect, at the end of a process.

    What an interrupted callback held hangs on the node that was spared and would outlive
    everything; Open3D ends a process with an error for that.
    """
    gc.unfreeze()
    gc.collect()

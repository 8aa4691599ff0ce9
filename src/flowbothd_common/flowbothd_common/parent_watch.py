"""Watch on the process that started this one, which this one must not outlive."""

from __future__ import annotations

import os
import select
import signal
import threading

PARENT_PID = "FLOWBOTHD_PARENT_PID"
"""Environment variable with the id of the process that this one must not outlive."""


def watch_parent() -> None:
    """Stop this process when the one named by `PARENT_PID` is gone, also after SIGKILL.

    A thread waits on the process's pidfd. Without the variable, nothing is watched.
    """
    pid = os.environ.get(PARENT_PID)
    if not pid or not hasattr(os, "pidfd_open"):
        return
    try:
        descriptor = os.pidfd_open(int(pid))
    except ProcessLookupError:
        raise SystemExit(f"the process that started this node (pid {pid}) is gone") from None

    def watch() -> None:
        select.select([descriptor], [], [])
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, name="parent_watch", daemon=True).start()

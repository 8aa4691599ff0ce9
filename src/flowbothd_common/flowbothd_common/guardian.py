"""Processes that must not outlive the one that started them."""

from __future__ import annotations

import os
import select
import signal
import threading

GUARDIAN = "FLOWBOTHD_GUARDIAN_PID"
"""Environment variable with the process id that this node must not outlive."""


def watch_guardian() -> None:
    """Stop this process when its guardian is gone, however it went; a thread watches its pidfd."""
    pid = os.environ.get(GUARDIAN)
    if not pid or not hasattr(os, "pidfd_open"):
        return
    try:
        descriptor = os.pidfd_open(int(pid))
    except ProcessLookupError:
        raise SystemExit(f"the process that started this node (pid {pid}) is gone") from None

    def watch() -> None:
        select.select([descriptor], [], [])
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, name="guardian", daemon=True).start()

"""A connection to hardware that is tried in the background, again and again."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from flowbothd_common.errors import FlowBotError


class Connection:
    """Keeps a call that may block for seconds off the thread that asks for it.

    Args:
        connect: Blocks until connected; raises FlowBotError where it cannot.
        retry: Time between a failure and the next attempt [s].
        name: What is connected to, in words.
    """

    def __init__(self, connect: Callable[[], None], retry: float, name: str) -> None:
        self.made = False
        self.trouble = f"connecting to {name}"
        self._connect, self._retry = connect, retry
        self._attempt: Future[None] | None = None
        self._retry_at = 0.0
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="connect")

    def poll(self) -> bool:
        """Go on with it; whether the connection is made. If not, `trouble` says why."""
        if self.made:
            return True
        if self._attempt is None:
            if time.monotonic() >= self._retry_at:
                self._attempt = self._worker.submit(self._connect)
            return False
        if not self._attempt.done():
            return False
        attempt, self._attempt = self._attempt, None
        try:
            attempt.result()
        except FlowBotError as error:
            self.trouble = str(error)
            self._retry_at = time.monotonic() + self._retry
            return False
        self.made = True
        return True

    def close(self) -> None:
        """Wait for an attempt that has begun, begin none."""
        self._worker.shutdown(wait=True, cancel_futures=True)

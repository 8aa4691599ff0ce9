"""A connection made again on request, without blocking whoever asks for longer than agreed."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future

from franka_suction_driver.backends.panda_link import PandaLink
from franka_suction_driver.backends.protocol import BackendError


class Reconnecting:
    """Opens a new link in the background; libfranka alone may wait for a minute.

    Args:
        open_link: Blocks until connected; raises BackendError where it cannot.
        address: Of the robot, for messages.
    """

    def __init__(self, open_link: Callable[[], PandaLink], address: str) -> None:
        self._open, self._address = open_link, address
        self._attempt: Future[PandaLink] | None = None

    def result(self, timeout: float) -> PandaLink:
        """Return the new link; an attempt that takes longer goes on, and the next call takes it.

        Raises:
            BackendError: it cannot be opened, or has not been within `timeout` [s].
        """
        attempt = self._attempt
        if attempt is None:
            attempt = self._attempt = Future()
            threading.Thread(
                target=self._try, args=(attempt,), name="reconnect", daemon=True
            ).start()
        try:
            link = attempt.result(timeout)
        except TimeoutError:
            raise BackendError(
                f"the robot at {self._address} has not answered within {timeout:g} s",
                hint="its connection is still being tried; call arm/recover again",
            ) from None
        except BackendError:
            self._attempt = None
            raise
        self._attempt = None
        return link

    def _try(self, attempt: Future[PandaLink]) -> None:
        try:
            attempt.set_result(self._open())
        except BackendError as error:
            attempt.set_exception(error)

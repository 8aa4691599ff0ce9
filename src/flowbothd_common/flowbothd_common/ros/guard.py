"""Callbacks that cannot end their node: what they refuse and what breaks them is published."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.timer import Timer

from flowbothd_common.errors import FlowBotError

_SHOWN = 2.0
"""How long a refusal or failure stays on diagnostics after it happened [s]."""


class Guard:
    """Wraps the callbacks of one node.

    A callback of a subscription that raises a FlowBotError has refused its message: the message
    counts as not received, and `troubles` says why. Any other exception is a failure: it is logged
    once with its traceback, and `failed` brings the node into its safe state.

    Args:
        node: Its logger is used.
        failed: Called with a text after an unexpected exception, on the callback's thread.
        refusals: Further exceptions that mean a refused message.
    """

    def __init__(
        self,
        node: Node,
        failed: Callable[[str], None] | None = None,
        refusals: tuple[type[Exception], ...] = (),
    ) -> None:
        self._node = node
        self._failed = failed
        self._refusals: tuple[type[Exception], ...] = (FlowBotError, *refusals)
        self._lock = threading.Lock()
        self._texts: dict[str, tuple[float, str]] = {}
        self._counts: dict[str, int] = {}
        self._logged: set[tuple[str, str]] = set()

    def subscribe(
        self,
        kind: type,
        topic: str,
        callback: Callable[[Any], None],
        quality: QoSProfile,
        *,
        raw: bool = False,
    ) -> None:
        """Subscribe; the callback raises FlowBotError for a message that it refuses."""
        take = partial(self.take, topic, callback)
        self._node.create_subscription(kind, topic, take, quality, raw=raw)

    def serve(self, kind: type, name: str, callback: Callable[[Any, Any], Any]) -> Any:
        """Offer a service and return it.

        After an exception the response says that it failed, in `success` or `ok`, and why.
        """
        answer = partial(self._answer, name, callback)
        return self._node.create_service(kind, name, answer)

    def every(self, period: float, callback: Callable[[], None]) -> Timer:
        """Call back every `period` [s] of the steady clock; every exception is a failure.

        The steady clock runs on when the simulation, and with it the node clock, has stopped.
        """
        guarded = partial(self.run, "timer", callback)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        return self._node.create_timer(period, guarded, clock=steady)

    def run(self, name: str, action: Callable[..., None], *args: Any) -> None:
        """Call `action(*args)`; an exception is a failure of `name`."""
        try:
            action(*args)
        except Exception as error:
            self.fail(name, error)

    def refuse(self, name: str, why: str) -> None:
        """Note a refused message that was not raised through a guarded callback."""
        with self._lock:
            self._texts[name] = (time.monotonic(), f"{name} refused: {why}")
            self._counts[name] = self._counts.get(name, 0) + 1

    def fail(self, name: str, error: Exception) -> None:
        """Note a failure, log it once, and bring the node into its safe state."""
        if not self._node.context.ok():
            return  # A shutdown takes publishers away in the middle of a callback.
        text = f"{name} failed: {error!r}"
        with self._lock:
            self._texts[name] = (time.monotonic(), text)
            self._counts[name] = self._counts.get(name, 0) + 1
            new = (name, repr(error)) not in self._logged
            self._logged.add((name, repr(error)))
        if new:
            trace = "".join(traceback.format_exception(error))
            self._node.get_logger().error(f"{text}\n{trace}")
        if self._failed is not None:
            try:
                self._failed(text)
            except Exception as second:
                self._node.get_logger().fatal(
                    f"{self._node.get_name()} could not reach its safe state: {second!r}",
                    throttle_duration_sec=1.0,
                )

    def troubles(self) -> list[str]:
        """Return what was refused or failed within the last seconds, in words."""
        now = time.monotonic()
        with self._lock:
            return [text for at, text in self._texts.values() if now - at < _SHOWN]

    def figures(self) -> dict[str, object]:
        """Return the number of refusals and failures of every callback, for diagnostics."""
        with self._lock:
            return {f"refused {name}": count for name, count in self._counts.items()}

    def take(self, name: str, callback: Callable[[Any], None], message: Any) -> None:
        """Call `callback(message)`; a FlowBotError is a refusal, anything else a failure."""
        try:
            callback(message)
        except self._refusals as error:
            self.refuse(name, str(error.args[0] if error.args else error))
        except Exception as error:
            self.fail(name, error)

    def _answer(
        self, name: str, callback: Callable[[Any, Any], Any], request: Any, response: Any
    ) -> Any:
        try:
            return callback(request, response)
        except self._refusals as error:
            text = str(error)
            self.refuse(name, text)
        except Exception as error:
            text = f"{name} failed: {error!r}; see the log of {self._node.get_name()}"
            self.fail(name, error)
        for field in ("success", "ok"):
            if hasattr(response, field):
                setattr(response, field, False)
        if hasattr(response, "message"):
            response.message = text
        return response

"""Publishes a node's state on /diagnostics, at once when it changes and once a second otherwise."""

from __future__ import annotations

import time
from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from flowbothd_common.ros.guard import Guard
from flowbothd_common.ros.liveness import HeartbeatPublisher

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR


class NodeStatus:
    """One node's health: heartbeat, /diagnostics and a log line at every change.

    Call `report` as often as there is something to tell; repeated reports cost nothing.

    Args:
        node: Publishes on it.
        guard: Of the node's callbacks: what it refused turns OK into WARN.
    """

    def __init__(self, node: Node, guard: Guard | None = None) -> None:
        self._node, self._guard = node, guard
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.heartbeat = HeartbeatPublisher(node)
        self._said: tuple[bytes, str] | None = None
        self._last = 0.0

    def report(
        self, level: bytes, message: str, values: Mapping[str, object] | None = None
    ) -> None:
        """Tell the node's state.

        Args:
            level: OK, WARN (works, but something is odd) or ERROR (cannot do its work).
            message: What is the matter, and what is missing by name.
            values: Further figures.
        """
        figures = dict(values or {})
        if self._guard is not None:
            figures |= self._guard.figures()
            troubles = self._guard.troubles()
            if troubles and level == OK:
                level, message = WARN, "; ".join(troubles)
        changed = self._said != (level, message)
        now = time.monotonic()
        if not changed and now - self._last < 1.0:
            return
        self._last = now
        if changed:
            self._said = (level, message)
            self.heartbeat.set_ready(level != ERROR, message)
            log = self._node.get_logger()
            if level == OK:
                log.info(message)
            elif level == WARN:
                log.warning(message)
            else:
                log.error(message)
        status = DiagnosticStatus(
            level=level,
            name=self._node.get_name(),
            message=message,
            values=[KeyValue(key=str(k), value=str(v)) for k, v in figures.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)

    def close(self) -> None:
        """Stop the heartbeat; to be called before the node is destroyed."""
        self.heartbeat.close()

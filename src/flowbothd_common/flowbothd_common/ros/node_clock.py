"""The node clock, and notice of one that stands still."""

from __future__ import annotations

import time

from rclpy.node import Node


class NodeClock:
    """Time of the node that runs on when its clock does not.

    With `use_sim_time` the clock is a topic like any other: it may never come, or stop while joint
    states still arrive. A motion timed by it would then go on for ever.

    Args:
        node: Whose clock is read.
        timeout: Time on the steady clock after which an unchanged clock stands still [s].
    """

    def __init__(self, node: Node, timeout: float) -> None:
        self._node, self._timeout = node, timeout
        self._last = float("nan")
        self._changed = time.monotonic()

    def now(self) -> float:
        """Return the time [s]; while the clock stands still, steady time is added to it."""
        now = float(self._node.get_clock().now().nanoseconds * 1e-9)
        steady = time.monotonic()
        if now != self._last:
            self._last, self._changed = now, steady
            return now
        still = steady - self._changed
        return now + still if still > self._timeout else now

    def problem(self) -> str:
        """Return how long the clock has stood still, in words; empty if it runs."""
        self.now()
        still = time.monotonic() - self._changed
        if still <= self._timeout:
            return ""
        if self._last == 0.0:
            return f"no /clock for {still:.1f} s (use_sim_time is set)"
        return (
            f"the clock has stood still for {still:.1f} s (use_sim_time is set: /clock has stopped)"
        )

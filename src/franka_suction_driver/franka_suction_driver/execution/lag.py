"""Notices an arm that does not do what it is commanded to do."""

from __future__ import annotations

from collections import deque

import numpy as np

from flowbothd_common.motion import JointState, RobotObservation
from flowbothd_common.types import Array

_WINDOW = 0.25
"""An arm may be late by so much [s]: trajectories and joint states travel."""


class LagWatch:
    """How far the arm is from everything that it was commanded to be lately.

    An arm that follows late is where the command was a moment ago, however fast it moves; one that
    is held is soon nowhere on that way. So a small distance tells one from the other.
    """

    def __init__(self) -> None:
        self._lately: deque[tuple[float, Array]] = deque()

    def restart(self) -> None:
        """Forget what was commanded: another motion begins."""
        self._lately.clear()

    def lag(self, seen: RobotObservation, commanded: JointState) -> float:
        """Largest distance of a joint from what it was commanded in the last moments [rad].

        Args:
            seen: What is measured.
            commanded: Joint state that the arm is commanded to have at `seen.time`.
        """
        self._lately.append((seen.time, commanded.position))
        # One from before the window stays: the way from there into it counts.
        while len(self._lately) > 1 and self._lately[1][0] <= seen.time - _WINDOW:
            self._lately.popleft()
        way = np.array([position for _, position in self._lately])
        below, above = way.min(axis=0) - seen.positions, seen.positions - way.max(axis=0)
        return float(np.maximum(below, above).max())

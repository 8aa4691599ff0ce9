"""The joint path along a straight tool motion, solved once and then timed as often as needed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from flowbothd_common.motion import JointTrajectory
from flowbothd_common.types import Array
from franka_suction_driver.execution.local_ik import LocalIk
from franka_suction_driver.execution.tool_reference import Reference, ToolLine

_SPACING = 0.003
"""Distance of two solved poses along the line [m]."""
_STRAIGHT = 4e-4
"""Largest deviation of the tip from the line between two solved poses [m]."""
_FEWEST = 8
"""Solved poses at least, for a spline with a sound second derivative."""


@dataclass(frozen=True)
class ToolPath:
    """Configurations over the travel along a line, as far as the arm reaches.

    Attributes:
        travel: (M,) travel of each node [m], from 0.
        solved: (M, J) configurations, which the spline runs through.
        usable: K, the nodes before the tip leaves the line. The spline is that through all of them:
            one that ends sooner would run elsewhere than what was checked.
    """

    travel: Array
    solved: Array
    usable: int

    @property
    def nodes(self) -> Array:
        """(K, J) configurations."""
        return self.solved[: self.usable]

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.travel, self.solved)

    @property
    def length(self) -> float:
        """How far it goes [m]."""
        return float(self.travel[self.usable - 1])

    def straight(self, line: ToolLine, solver: LocalIk) -> int:
        """How many nodes there are before the tip leaves the line in between."""
        if len(self.solved) < 2:
            return len(self.solved)
        between = (self.travel[1:] + self.travel[:-1]) / 2
        tips = solver.tips(self._spline(between))
        miss = np.linalg.norm(tips - line.origin - np.outer(between, line.direction), axis=1)
        bent = np.flatnonzero(miss > _STRAIGHT)
        return int(bent[0]) + 1 if len(bent) else len(self.solved)

    def timed(
        self, names: tuple[str, ...], reference: Reference, times: Array, since: float = 0.0
    ) -> JointTrajectory:
        """The path under the reference's timing, which must not lead beyond its length.

        Args:
            names: Of the joints.
            reference: Its offset is not looked at.
            times: (T,) when to sample; the last is its end.
            since: Time on the motion's clock that they count from [s].
        """
        travel, rate, change = reference.along.sample(since - reference.along_since + times)
        s = np.clip(travel[:, 0], 0.0, self.length)
        spline = self._spline
        first, second = spline(s, 1), spline(s, 2)
        velocities = first * rate
        accelerations = first * change + second * rate**2
        velocities[-1] = 0.0
        accelerations[-1] = 0.0
        return JointTrajectory(names, times, spline(s), velocities, accelerations)


def solve_path(line: ToolLine, start: Array, solver: LocalIk) -> ToolPath:
    """Follow a line from `start` (J,), in equal steps, as far as the arm reaches.

    The path ends where the joints bend so much that the tip would leave the line between steps.
    """
    path = _stepped(line, start, solver)
    return replace(path, usable=path.straight(line, solver))


def _stepped(line: ToolLine, start: Array, solver: LocalIk) -> ToolPath:
    count = max(_FEWEST, int(np.ceil(line.length / _SPACING)))
    travel = np.linspace(0.0, line.length, count + 1)
    nodes = [start]
    for way in travel[1:]:
        guess = solver.ahead(nodes[-2], nodes[-1]) if len(nodes) > 1 else start
        q = solver.reach(guess, line.origin + line.direction * way, line.axis(float(way)))
        if q is None:
            break
        nodes.append(q)
    return ToolPath(travel[: len(nodes)], np.array(nodes), len(nodes))

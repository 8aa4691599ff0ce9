"""Straight tool motions with a sideways offset, and the joint trajectories that realise them.

The reference is the sum of two jerk-limited motions, both termination at rest: along the direction,
and an offset that admittance moves. Replacing either part therefore leaves position, velocity and
acceleration of the whole continuous.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos, sin

import numpy as np

from flowbothd_common.motion import JointState
from flowbothd_common.transforms import angle_between, unit
from flowbothd_common.types import Array
from franka_suction_driver.arm.trajectory import Profile, brake, move_to


@dataclass(frozen=True)
class Bounds:
    """Largest speed [m/s], acceleration [m/s^2] and jerk [m/s^3] of one part of the reference."""

    speed: float
    acceleration: float = 0.5
    jerk: float = 8.0

    def scaled(self, factor: float) -> Bounds:
        """The same motion with time stretched by 1 / factor."""
        return Bounds(self.speed * factor, self.acceleration * factor**2, self.jerk * factor**3)


OFFSET_BOUNDS = Bounds(0.08, 0.4, 6.0)
"""Bounds of the sideways offset: fast enough to follow a door's arc at the speed of a step, slow
enough for force control at 60 Hz."""


@dataclass(frozen=True)
class ToolLine:
    """Geometry of a straight tool motion.

    Attributes:
        origin: (3,) tip position where it starts, in base [m].
        direction: (3,) unit direction of travel.
        length: [m].
        axis_start: (3,) tool axis at the start.
        axis_end: (3,) tool axis after `turn_length` of travel.
        turn_length: [m].
    """

    origin: Array
    direction: Array
    length: float
    axis_start: Array
    axis_end: Array
    turn_length: float

    def axis(self, travel: float) -> Array:
        """(3,) tool axis after `travel` [m]; turns smoothly, without a jump in acceleration."""
        angle, aside = self._turn
        if angle < 1e-9 or self.turn_length <= 0:
            return self.axis_end if travel > 0 else self.axis_start
        u = min(1.0, max(0.0, travel / self.turn_length))
        turned = angle * u**3 * (10 - 15 * u + 6 * u * u)
        return np.asarray(cos(turned) * self.axis_start + sin(turned) * aside)

    @cached_property
    def _turn(self) -> tuple[float, Array]:
        """Angle of the turn [rad], and the unit vector square to its start that it leads to."""
        angle = angle_between(self.axis_start, self.axis_end)
        turn = np.cross(self.axis_start, self.axis_end)
        if angle < 1e-9:
            return angle, self.axis_start
        return angle, np.cross(unit(turn), self.axis_start)


@dataclass
class Reference:
    """Where the tool is commanded to go, as two profiles on the motion's own clock.

    Attributes:
        line: The straight motion.
        along: One coordinate, travel [m], started at `along_since` [s].
        along_since: Time on the motion's clock.
        offset: Three coordinates [m], started at `offset_since` [s].
        offset_since: Time on the motion's clock.
        offset_bounds: How fast the offset may be moved; fixed for the whole motion.
    """

    line: ToolLine
    along: Profile
    along_since: float
    offset: Profile
    offset_since: float
    offset_bounds: Bounds = OFFSET_BOUNDS

    @staticmethod
    def start(line: ToolLine, bounds: Bounds, goal: float | None = None) -> Reference:
        """Begin at rest at the line's origin, towards its end or `goal` [m] before it."""
        goal = line.length if goal is None else goal
        along = _move(JointState.at_rest(np.zeros(1)), np.full(1, goal), bounds)
        still = _move(JointState.at_rest(np.zeros(3)), np.zeros(3), OFFSET_BOUNDS)
        return Reference(line, along, 0.0, still, 0.0)

    @property
    def along_end(self) -> float:
        """Time at which the motion along the direction is at rest [s]."""
        return self.along_since + self.along.duration

    @property
    def end(self) -> float:
        """Time at which both parts are at rest [s]."""
        return max(self.along_end, self.offset_since + self.offset.duration)

    def travel(self, time: float) -> JointState:
        """Motion along the direction at `time`."""
        return _at(self.along, time - self.along_since)

    def offset_state(self, time: float) -> JointState:
        """Sideways motion at `time`."""
        return _at(self.offset, time - self.offset_since)

    def redirect(self, time: float, goal: float, bounds: Bounds) -> None:
        """From `time` on, travel to `goal` [m] along the direction."""
        self.along = _move(self.travel(time), np.full(1, goal), bounds)
        self.along_since = time

    def slow_down(self, time: float, speed: float) -> None:
        """From `time` on, travel to the same goal at `speed` [m/s] at most."""
        goal = float(_at(self.along, self.along.duration).position[0])
        self.redirect(time, goal, Bounds(speed))

    def halt(self, time: float, bounds: Bounds) -> None:
        """From `time` on, brake along the direction."""
        self.along = brake(
            self.travel(time), np.full(1, bounds.acceleration), np.full(1, bounds.jerk)
        )
        self.along_since = time

    def shift(self, time: float, goal: Array) -> None:
        """From `time` on, move the offset to `goal` (3,) [m].

        The bounds are always the same: with tighter ones than the running motion was made for,
        it could only be stopped after a long way.
        """
        self.offset = _move(self.offset_state(time), goal, self.offset_bounds)
        self.offset_since = time

    def pose(self, time: float) -> tuple[Array, Array]:
        """(3,) tip position and (3,) tool axis commanded at `time`."""
        travel = float(self.travel(time).position[0])
        line = self.line
        position = line.origin + line.direction * travel + self.offset_state(time).position
        return position, line.axis(travel)


def _move(start: JointState, goal: Array, bounds: Bounds) -> Profile:
    ones = np.ones(len(goal))
    return move_to(start, goal, ones * bounds.speed, ones * bounds.acceleration, ones * bounds.jerk)


def _at(profile: Profile, time: float) -> JointState:
    """State of a profile; at rest after its end, whatever rounding says."""
    if time >= profile.duration:
        return JointState.at_rest(profile.at(profile.duration).position)
    return profile.at(time)

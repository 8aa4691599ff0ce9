"""Straight tool motions with a sideways offset, and the joint trajectories that realise them.

The reference is the sum of two jerk-limited motions, both ending at rest: along the direction,
and an offset that admittance moves. Replacing either part therefore leaves position, velocity and
acceleration of the whole continuous.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from flowbothd_common.motion import JointTrajectory
from flowbothd_common.transforms import angle_between, rotation_about
from flowbothd_common.types import Array
from franka_suction_driver.inverse_kinematics import PositionBox, limited_step
from franka_suction_driver.kinematics import Kinematics, conditioning, task_error, task_jacobian
from franka_suction_driver.limits import JointLimits
from franka_suction_driver.trajectory import (
    JointState,
    Profile,
    brake,
    joint_stop,
    move_to,
    sample_times,
)

STEP = 0.04
"""Time between two points of a tool trajectory [s]."""
_TOLERANCE = 5e-4
_SLOWINGS = (1.0, 0.75, 0.5, 0.3)
_SHORTENINGS = 5
_STEP_BACK = 0.004
_BRAKINGS = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)
_MOST_SAMPLES = 50
_GIVING_WAY = np.array([1.0, 1.0, 1.0, 0.05, 0.05])


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
        angle = angle_between(self.axis_start, self.axis_end)
        if angle < 1e-9 or self.turn_length <= 0:
            return self.axis_end if travel > 0 else self.axis_start
        u = min(1.0, max(0.0, travel / self.turn_length))
        part = u**3 * (10 - 15 * u + 6 * u * u)
        turn = np.cross(self.axis_start, self.axis_end)
        return np.asarray(rotation_about(turn, angle * part) @ self.axis_start)


@dataclass
class Reference:
    """Where the tool is commanded to go, as two profiles on the motion's own clock.

    Attributes:
        line: The straight motion.
        along: One coordinate, travel [m], started at `along_since` [s].
        along_since: Time on the motion's clock.
        offset: Three coordinates [m], started at `offset_since` [s].
        offset_since: Time on the motion's clock.
    """

    line: ToolLine
    along: Profile
    along_since: float
    offset: Profile
    offset_since: float

    @staticmethod
    def start(line: ToolLine, bounds: Bounds) -> Reference:
        """Begin at rest at the line's origin, towards its end."""
        along = _move(JointState.at_rest(np.zeros(1)), np.full(1, line.length), bounds)
        still = _move(JointState.at_rest(np.zeros(3)), np.zeros(3), OFFSET_BOUNDS)
        return Reference(line, along, 0.0, still, 0.0)

    @property
    def end(self) -> float:
        """Time at which both parts are at rest [s]."""
        return max(self.along_since + self.along.duration, self.offset_since + self.offset.duration)

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
        self.offset = _move(self.offset_state(time), goal, OFFSET_BOUNDS)
        self.offset_since = time

    def pose(self, time: float) -> tuple[Array, Array]:
        """(3,) tip position and (3,) tool axis commanded at `time`."""
        travel = float(self.travel(time).position[0])
        line = self.line
        position = line.origin + line.direction * travel + self.offset_state(time).position
        return position, line.axis(travel)


@dataclass(frozen=True)
class Rollout:
    """A reference turned into joint motion.

    Attributes:
        trajectory: As far as the reference could be followed, within the joint limits; None if
            not even the first sample could.
        travel: How far along the direction it goes [m].
        problem: Empty, or what ends it early: ``joint_limit`` or ``singularity``.
        too_fast: It breaks a velocity, acceleration or jerk limit.
        slowing: How much slower than asked it had to be planned, 0..1.
        detail: For people.
    """

    trajectory: JointTrajectory | None
    travel: float
    problem: str = ""
    detail: str = ""
    too_fast: bool = False
    slowing: float = 1.0

    @property
    def good(self) -> bool:
        """Whether it goes all the way within the limits."""
        return self.trajectory is not None and not self.problem


class ToolFollower:
    """Turns references into joint trajectories.

    Args:
        kinematics: The arm.
        limits: Joint limits, never exceeded.
        box: Position limits with their margin.
        tilt_slack: Tilt that is accepted in order to stay in reach [rad].
    """

    def __init__(
        self, kinematics: Kinematics, limits: JointLimits, box: PositionBox, tilt_slack: float
    ) -> None:
        self._kinematics = kinematics
        self._limits = limits
        self._box = box
        self._slack = tilt_slack

    def rollout(self, reference: Reference, now: float, start: JointState) -> Rollout:
        """Follow the reference from `now` to its end, beginning in the commanded state `start`.

        Args:
            reference: What the tool shall do.
            now: Time on the motion's clock [s].
            start: Commanded joint state at that time.
        """
        duration = reference.end - now
        times = sample_times(duration, max(STEP, duration / _MOST_SAMPLES))
        positions = np.empty((len(times), self._kinematics.dof))
        q = start.position
        for k, time in enumerate(times):
            reached = self._reach(q, *reference.pose(now + time))
            if reached is None:
                travel = float(reference.travel(now + time).position[0])
                return Rollout(None, travel, *self._why(q))
            q = positions[k] = reached
        rates = CubicSpline(
            np.concatenate([[0.0], times]),
            np.vstack([start.position, positions]),
            bc_type=((1, start.velocity), (1, np.zeros_like(q))),
        )
        velocities, accelerations = rates(times, 1), rates(times, 2)
        velocities[-1] = 0.0
        accelerations[-1] = 0.0
        names = self._kinematics.joint_names
        trajectory = JointTrajectory(names, times, positions, velocities, accelerations)
        violation = self._limits.violation(trajectory)
        if violation is not None:
            travel = float(reference.travel(now + violation.time).position[0])
            kind, _ = self._why(positions[int(np.searchsorted(times, violation.time))])
            return Rollout(trajectory, travel, kind, str(violation), too_fast=True)
        return Rollout(trajectory, float(reference.travel(reference.end).position[0]))

    def plan(self, line: ToolLine, bounds: Bounds, start: JointState) -> tuple[Reference, Rollout]:
        """A reference from rest that is within reach and within the joint limits.

        It is slowed down until the limits hold, and shortened to what the arm can reach; what
        made it shorter is the problem of the rollout. Without any way to go, the rollout has no
        trajectory.
        """
        goal = line.length
        shortened: Rollout | None = None
        for _ in range(_SHORTENINGS):
            for slowing in _SLOWINGS:
                reference = Reference.start(line, bounds.scaled(slowing))
                if goal < line.length:
                    reference.redirect(0.0, goal, bounds.scaled(slowing))
                rollout = self.rollout(reference, 0.0, start)
                if not rollout.too_fast:
                    break
            if rollout.good:
                why = ("", "") if shortened is None else (shortened.problem, shortened.detail)
                return reference, replace(rollout, slowing=slowing, problem=why[0], detail=why[1])
            shortened = rollout
            goal = min(rollout.travel, goal) - _STEP_BACK
            if goal < _STEP_BACK:
                break
        why = ("singularity", "") if shortened is None else (shortened.problem, shortened.detail)
        return Reference.start(line, bounds), Rollout(None, 0.0, *why)

    def brake(
        self, reference: Reference, now: float, start: JointState
    ) -> tuple[Reference, JointTrajectory]:
        """Stop along the direction as hard as the joint limits allow; the offset keeps its goal.

        Args:
            reference: What the tool was doing.
            now: Time on the motion's clock [s].
            start: Commanded joint state at that time.
        """
        slowest = replace(reference)
        for hardness in _BRAKINGS:
            slowest = replace(reference)
            slowest.halt(now, Bounds(0.1, hardness, 40.0 * hardness))
            slowest.shift(now, slowest.offset_state(now).position)
            rollout = self.rollout(slowest, now, start)
            if rollout.good and rollout.trajectory is not None:
                return slowest, rollout.trajectory
        # Off the line, but to rest within the limits, which comes first.
        return slowest, joint_stop(self._kinematics.joint_names, start, self._limits)

    def _reach(self, q: Array, position: Array, axis: Array) -> Array | None:
        """Configuration next to `q` at the tool pose, tilted as little as needed, or None."""
        for attempt in range(12):
            state = self._kinematics.tip(q)
            miss = task_error(state, position, axis)
            if np.linalg.norm(miss) < 1e-7:
                return q
            jacobian = task_jacobian(state)
            if attempt >= 3:
                # Out of reach as asked: hold the position and let the tilt give way.
                if np.linalg.norm(miss[:3]) < _TOLERANCE / 5:
                    break
                miss, jacobian = miss * _GIVING_WAY, jacobian * _GIVING_WAY[:, None]
            elif attempt and np.linalg.norm(miss) < 1e-5:
                return q
            q = self._box.clip(q + limited_step(self._box, q, jacobian, miss))
        miss = task_error(self._kinematics.tip(q), position, axis)
        near = np.linalg.norm(miss[:3]) < _TOLERANCE
        return q if near and np.linalg.norm(miss[3:]) < max(self._slack, 1e-3) else None

    def _why(self, q: Array) -> tuple[str, str]:
        lower, upper = q - self._box.lower, self._box.upper - q
        room = np.minimum(lower, upper)
        if room.min() < 1e-3:
            joint = int(room.argmin())
            name = self._kinematics.joint_names[joint]
            end = "lower" if lower[joint] < upper[joint] else "upper"
            return "joint_limit", f"{name} is at its {end} limit ({q[joint]:.2f} rad)"
        value = float(conditioning(self._kinematics.tip(q)))
        return "singularity", f"the arm is stretched out (smallest singular value {value:.3f})"


def _move(start: JointState, goal: Array, bounds: Bounds) -> Profile:
    ones = np.ones(len(goal))
    return move_to(start, goal, ones * bounds.speed, ones * bounds.acceleration, ones * bounds.jerk)


def _at(profile: Profile, time: float) -> JointState:
    """State of a profile; at rest after its end, whatever rounding says."""
    if time >= profile.duration:
        return JointState.at_rest(profile.at(profile.duration).position)
    return profile.at(time)
